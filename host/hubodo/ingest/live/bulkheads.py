"""Bulkheads of a recording: a fault or hang of one part is counted and reported, and affects no other part.

A part is a link, a node, a receiver, the odometry or an output. No fault of a part ends a recording; only a
log that can no longer be written does, because the event about a fault is written outside any bulkhead.
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

HANG_TIMEOUT_S = 2.0
_CHECKS_PER_HANG = 20
"""Number of checks that must find no progress; a computer that stalls delays the checks as well."""
_REPORT_PERIOD_NS = 10 * NS_PER_S
_MIN_PAUSE_NS, _MAX_PAUSE_NS = NS_PER_S, 60 * NS_PER_S
_MAX_CAUSE_BYTES = 256
_INTERRUPT_SIGNAL = int(getattr(signal, "SIGRTMIN", 0) or getattr(signal, "SIGUSR2", 0))
"""Signal that interrupts the main thread; 0 on Windows, where only the threads of outputs are watched."""


class PartHung(BaseException):
    """Raised inside a part that has not returned in time; not an `Exception`, so no part catches it."""


class WatchedOutput(Protocol):
    """A thread of an output, checked about ten times per second."""

    def check_stall(self) -> None:
        """Report once if the present item takes too long."""
        ...


@dataclass(slots=True)
class _Part:
    """State of one part.

    faults, skipped: numbers of faults and of calls omitted during suspensions; pause_ns: duration of the
    newest suspension, which each consecutive fault doubles.
    """

    name: str
    faults: int = 0
    skipped: int = 0
    reported: int = 0
    next_report_ns: int = 0
    pause_ns: int = 0
    resume_ns: int = 0
    error: str = ""
    location: str = ""
    cause: bytes = b""

    def end_suspension(self) -> None:
        """End the suspension and reset the pause of the next one."""
        self.pause_ns = self.resume_ns = 0


class Bulkheads:
    """Runs the parts of a recording and counts their faults.

    Parameters
    ----------
    now_ns
        Host time, ns since 1970.
    hang_timeout_s
        Seconds after which a part that has not returned is interrupted.
    """

    def __init__(self, now_ns: Callable[[], int], *, hang_timeout_s: float = HANG_TIMEOUT_S) -> None:
        self._now_ns = now_ns
        self._check_s = hang_timeout_s / _CHECKS_PER_HANG
        self._hang_s = hang_timeout_s
        self._parts: dict[str, _Part] = {}
        self._lock = threading.Lock()
        self._outputs: list[WatchedOutput] = []
        self._depth = 0  # number of nested calls of `run`
        self._writes_active = 0
        self._progress = 0  # increases with each start and end of a call
        self._hung_progress = -1  # progress at which the current call was detected to hang
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
            True if a fault suspends the part, as a hang always does: for 1 s, doubled up to 60 s by each
            further consecutive fault. A suspended part is not called.
        """
        part = self._parts.get(name) or self._add_part(name)
        if part.resume_ns and self._now_ns() < part.resume_ns:
            part.skipped += 1
            return False
        self._progress += 1
        self._depth += 1
        try:
            action(*args)
        except (Exception, PartHung) as error:  # noqa: BLE001 a bulkhead stops any exception
            self._record_fault(part, error, cause, pausing or isinstance(error, PartHung))
            return False
        finally:
            self._depth -= 1
            self._progress += 1
        part.end_suspension()
        return True

    def record_fault(
        self, name: str, error: BaseException, cause: bytes = b"", *, pausing: bool = True
    ) -> None:
        """Count a fault of a part that was not called by `run`; from any thread."""
        self._record_fault(self._parts.get(name) or self._add_part(name), error, cause, pausing)

    def end_suspension(self, name: str) -> None:
        """End the suspension of a part that was not called by `run`; from any thread."""
        part = self._parts.get(name)
        if part is not None:
            part.end_suspension()

    def is_suspended(self, name: str) -> bool:
        """Return True while a part is suspended."""
        part = self._parts.get(name)
        return part is not None and self._now_ns() < part.resume_ns

    def fault_counts(self) -> dict[str, int]:
        """Return the number of faults of each part with at least one, since the start."""
        with self._lock:
            return {part.name: part.faults for part in self._parts.values() if part.faults}

    def due_reports(self, *, final: bool = False) -> list[Event]:
        """Return the events that are due: each part's first fault at once, later ones every ten seconds."""
        now_ns = self._now_ns()
        with self._lock:
            due = [part for part in self._parts.values() if part.faults > part.reported]
            return [_fault_event(part, now_ns) for part in due if final or now_ns >= part.next_report_ns]

    @contextmanager
    def protect_write(self) -> Iterator[None]:
        """Prevent interruption of a write to the log, so that no record is left incomplete."""
        self._writes_active += 1
        try:
            yield
        finally:
            self._writes_active -= 1

    def watch_output(self, output: WatchedOutput) -> None:
        """Check the thread of an output from now on."""
        self._outputs.append(output)

    @contextmanager
    def watch_for_hangs(self) -> Iterator[None]:
        """Interrupt parts that hang, if this is the main thread, and check the threads of outputs."""
        main = threading.main_thread()
        interruptible = threading.current_thread() is main and bool(_INTERRUPT_SIGNAL)
        before = signal.signal(_INTERRUPT_SIGNAL, self._interrupt) if interruptible else None
        target = main.ident if interruptible else None
        watchdog = threading.Thread(target=self._run_watchdog, args=(target,), name="watchdog", daemon=True)
        watchdog.start()
        try:
            yield
        finally:
            self._closing.set()
            watchdog.join()
            if interruptible:
                signal.signal(_INTERRUPT_SIGNAL, before)

    def _run_watchdog(self, main_thread: int | None) -> None:
        """Interrupt a part that makes no progress over consecutive checks, and check outputs for stalls."""
        unchanged = last_progress = 0
        while not self._closing.wait(self._check_s):
            unchanged = unchanged + 1 if self._depth and self._progress == last_progress else 0
            last_progress = self._progress
            if unchanged >= _CHECKS_PER_HANG and main_thread is not None:
                self._hung_progress = last_progress
                signal.pthread_kill(main_thread, _INTERRUPT_SIGNAL)
            for output in self._outputs:
                output.check_stall()

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        """Raise PartHung in the main thread, inside the part that hangs."""
        if self._depth and not self._writes_active and self._progress == self._hung_progress:
            self._hung_progress = -1
            raise PartHung(f"no return within {self._hang_s:g} s; interrupted")

    def _add_part(self, name: str) -> _Part:
        with self._lock:
            return self._parts.setdefault(name, _Part(name))

    def _record_fault(self, part: _Part, error: BaseException, cause: bytes, pausing: bool) -> None:
        with self._lock:
            part.faults += 1
            part.error = " ".join(f"{type(error).__name__}: {error}".split())
            part.location = _raise_location(error)
            part.cause = bytes(cause[:_MAX_CAUSE_BYTES])
            if pausing:
                part.pause_ns = min(max(2 * part.pause_ns, _MIN_PAUSE_NS), _MAX_PAUSE_NS)
                part.resume_ns = self._now_ns() + part.pause_ns


def _fault_event(part: _Part, now_ns: int) -> Event:
    new, part.reported = part.faults - part.reported, part.faults
    part.next_report_ns = now_ns + _REPORT_PERIOD_NS
    text = (
        f"{part.name}: {part.error} (at {part.location})" if part.location else f"{part.name}: {part.error}"
    )
    if part.faults > 1:
        text += f"; {new} faults since the last report, {part.faults} in total"
    if part.pause_ns:
        text += f"; retried in {part.pause_ns / NS_PER_S:.0f} s"
    data = {
        "part": part.name,
        "new": new,
        "total": part.faults,
        "skipped": part.skipped,
        "error": part.error,
        "place": part.location,
        "cause": part.cause.hex(),
    }
    return Event(now_ns, "fault", part.name, f"{text}; the recording continues", data)


def _raise_location(error: BaseException) -> str:
    """Return the file and line where an error was raised, for a defect report."""
    trace = error.__traceback__
    if trace is None:
        return ""
    while trace.tb_next is not None:
        trace = trace.tb_next
    return f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
