"""Bulkheads of a recording: an exception or a hang of one part is counted, reported, and costs it alone.

A part is a link, a node, a receiver, the odometry or an output. Nothing that a part does ends a recording.
Only a log that can no longer be written does: the event about a fault is written outside of any bulkhead.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Protocol

from hubodo.recording import Event
from hubodo.units import NS_PER_S

HANG_S = 2.0
_CHECKS_PER_HANG = 20
"""A computer that stalls stalls the checks as well, so that it is not mistaken for a part that hangs."""
_REPORT_PERIOD_NS = 10 * NS_PER_S
_MIN_PAUSE_NS, _MAX_PAUSE_NS = NS_PER_S, 60 * NS_PER_S
_MAX_CAUSE_BYTES = 256
_INTERRUPT = int(getattr(signal, "SIGRTMIN", 0) or getattr(signal, "SIGUSR2", 0))
"""Interrupts the main thread; 0 on Windows, where only the threads of outputs are watched."""


class PartHung(BaseException):
    """Raised inside a part that has not returned in time; no handler of `Exception` can swallow it."""


class Stallable(Protocol):
    """A thread of an output, checked ten times a second or so."""

    def check_stall(self) -> None:
        """Report once when the item at hand has taken too long."""
        ...


@dataclass(slots=True)
class _Part:
    """faults, skipped: since the start. pause_ns: the current one, doubled by each fault in a row."""

    name: str
    faults: int = 0
    skipped: int = 0
    reported: int = 0
    next_report_ns: int = 0
    pause_ns: int = 0
    resume_ns: int = 0
    error: str = ""
    place: str = ""
    cause: bytes = b""

    def resume(self) -> None:
        """End a suspension, and the row of faults that the next one would be doubled for."""
        self.pause_ns = self.resume_ns = 0


class Bulkheads:
    """Runs the parts of a recording and keeps account of their faults.

    Parameters
    ----------
    now_ns
        Host time, ns since 1970.
    hang_s
        Seconds after which a part that has not returned is interrupted.
    """

    def __init__(self, now_ns: Callable[[], int], *, hang_s: float = HANG_S) -> None:
        self._now_ns = now_ns
        self._check_s = hang_s / _CHECKS_PER_HANG
        self._hang_s = hang_s
        self._parts: dict[str, _Part] = {}
        self._lock = threading.Lock()
        self._outputs: list[Stallable] = []
        self._depth = 0  # of nested calls of `run`
        self._writing = 0
        self._progress = 0  # grows with each begin and end of a part
        self._hung_at = -1  # the progress at which the current part was found to hang
        self._closing = threading.Event()

    def run(
        self,
        name: str,
        action: Callable[..., object],
        *args: object,
        cause: bytes = b"",
        pausing: bool = False,
    ) -> bool:
        """Call `action(*args)` as the part `name`; return True if it completed.

        Parameters
        ----------
        cause
            The bytes that the action works on, for the event about a fault.
        pausing
            Whether a fault suspends the part for a while, as a hang always does: 1 s, doubled up to 60 s by
            each further fault in a row. A suspended part is not called.
        """
        part = self._parts.get(name) or self._add(name)
        if part.resume_ns and self._now_ns() < part.resume_ns:
            part.skipped += 1
            return False
        self._progress += 1
        self._depth += 1
        try:
            action(*args)
        except (Exception, PartHung) as error:  # noqa: BLE001 a bulkhead stops whatever comes
            self._fail(part, error, cause, pausing or isinstance(error, PartHung))
            return False
        finally:
            self._depth -= 1
            self._progress += 1
        part.resume()
        return True

    def record(self, name: str, error: BaseException, cause: bytes = b"", *, pausing: bool = True) -> None:
        """Count a fault of a part that was not called by `run`; from any thread."""
        self._fail(self._parts.get(name) or self._add(name), error, cause, pausing)

    def succeeded(self, name: str) -> None:
        """End the suspension of a part that was not called by `run`; from any thread."""
        part = self._parts.get(name)
        if part is not None:
            part.resume()

    def is_suspended(self, name: str) -> bool:
        """Return True while a part is not to be called."""
        part = self._parts.get(name)
        return part is not None and self._now_ns() < part.resume_ns

    def counts(self) -> dict[str, int]:
        """Return the number of faults of each part that has had any, since the start."""
        with self._lock:
            return {part.name: part.faults for part in self._parts.values() if part.faults}

    def reports(self, *, final: bool = False) -> list[Event]:
        """Return the events that are due: each part's first fault at once, later ones every ten seconds."""
        now_ns = self._now_ns()
        with self._lock:
            due = [part for part in self._parts.values() if part.faults > part.reported]
            return [_report(part, now_ns) for part in due if final or now_ns >= part.next_report_ns]

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Protect the log: a write is never interrupted, so that no record is left half written."""
        self._writing += 1
        try:
            yield
        finally:
            self._writing -= 1

    def watch(self, output: Stallable) -> None:
        """Check the thread of an output from now on."""
        self._outputs.append(output)

    @contextmanager
    def watching_for_hangs(self) -> Iterator[None]:
        """Interrupt parts that hang, where this is the main thread, and check the threads of outputs."""
        main = threading.main_thread()
        interruptible = threading.current_thread() is main and bool(_INTERRUPT)
        before = signal.signal(_INTERRUPT, self._interrupt) if interruptible else None
        target = main.ident if interruptible else None
        watchdog = threading.Thread(target=self._watch, args=(target,), name="watchdog", daemon=True)
        watchdog.start()
        try:
            yield
        finally:
            self._closing.set()
            watchdog.join()
            if interruptible:
                signal.signal(_INTERRUPT, before)

    def _watch(self, main_thread: int | None) -> None:
        """The watchdog: a part that makes no progress over a row of checks hangs."""
        unchanged = seen = 0
        while not self._closing.wait(self._check_s):
            unchanged = unchanged + 1 if self._depth and self._progress == seen else 0
            seen = self._progress
            if unchanged >= _CHECKS_PER_HANG and main_thread is not None:
                self._hung_at = seen
                signal.pthread_kill(main_thread, _INTERRUPT)
            for output in self._outputs:
                output.check_stall()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        """Runs in the main thread, between two instructions of whatever hangs there."""
        if self._depth and not self._writing and self._progress == self._hung_at:
            self._hung_at = -1
            raise PartHung(f"no return within {self._hang_s:g} s; interrupted")

    def _add(self, name: str) -> _Part:
        with self._lock:
            return self._parts.setdefault(name, _Part(name))

    def _fail(self, part: _Part, error: BaseException, cause: bytes, pausing: bool) -> None:
        with self._lock:
            part.faults += 1
            part.error = " ".join(f"{type(error).__name__}: {error}".split())
            part.place = _place(error)
            part.cause = bytes(cause[:_MAX_CAUSE_BYTES])
            if pausing:
                part.pause_ns = min(max(2 * part.pause_ns, _MIN_PAUSE_NS), _MAX_PAUSE_NS)
                part.resume_ns = self._now_ns() + part.pause_ns


def _report(part: _Part, now_ns: int) -> Event:
    new, part.reported = part.faults - part.reported, part.faults
    part.next_report_ns = now_ns + _REPORT_PERIOD_NS
    text = f"{part.name}: {part.error} (at {part.place})" if part.place else f"{part.name}: {part.error}"
    if part.faults > 1:
        text += f"; {new} faults since the last report, {part.faults} in all"
    if part.pause_ns:
        text += f"; tried again in {part.pause_ns / NS_PER_S:.0f} s"
    data = {
        "part": part.name,
        "new": new,
        "total": part.faults,
        "skipped": part.skipped,
        "error": part.error,
        "place": part.place,
        "cause": part.cause.hex(),
    }
    return Event(now_ns, "fault", part.name, f"{text}; the recording goes on", data)


def _place(error: BaseException) -> str:
    """Return file and line where an error was raised, for a report of the defect."""
    trace = error.__traceback__
    if trace is None:
        return ""
    while trace.tb_next is not None:
        trace = trace.tb_next
    return f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
