"""The processor of a board: the interpreter that runs, what it is told at a start, its calls and answers."""

from __future__ import annotations

import os
import select
from typing import NamedTuple, NoReturn

from hubodo.emulator.board.clock import BoardClock
from hubodo.emulator.board.hypercall import FLAG_OVER, REQUEST, RESPONSE, op_codes
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.reset_registers import ResetRegisters, Why
from hubodo.emulator.board.settings import BoardSettings, Flash
from hubodo.emulator.interpreters.interpreter import Interpreter, InterpreterDied, start
from hubodo.emulator.interpreters.rp2040.pico import Pico
from hubodo.units import NS_PER_S

USB_FRAME_NS = 1_000_000
STEPPED_REFRESH_NS = 4_000_000
_SLACK_BYTES = 98304
_EPOCH_MS = 1_609_459_200_000
_FREQUENCY_HZ = 125_000_000


class Request(NamedTuple):
    """A call of the interpreter, made at `t` ns."""

    op: int
    interrupt_char: int
    a: int
    payload: bytes
    t: float


class Processor:
    """One interpreter at a time; `poll`: where its requests are waited for."""

    def __init__(self, settings: BoardSettings, clock: BoardClock, flash: Flash, poll: select.poll) -> None:
        assert flash.folder is not None
        self._settings, self._clock, self._poll = settings, clock, poll
        self._folder, self._journal = flash.folder, flash.journal
        self._model = MODELS[settings.model]
        self._registers = ResetRegisters(self._model)
        self._boot_ns = 0.0
        self._pico: Pico | None = None
        self._interpreter: Interpreter | None = None
        self._buffer = bytearray()
        self._answered = True
        self._cpu = 0.0

    def power_on(self) -> None:
        """The board is switched on. Raises ImageMissing, FlashUnreadable: see `Pico`."""
        if self._settings.emulated:
            self._pico = Pico(self._settings.pico, self._folder)

    def mirror_flash(self) -> None:
        """What an emulated Pico's flash chip holds, to its folder; other boards keep it there."""
        if self._pico is not None:
            self._pico.mirror()

    def restarted(self, why: Why) -> None:
        """A reset has happened: what it leaves in the registers, and when the next start is."""
        self._registers.reset(why)
        self._boot_ns = self._clock.now()

    def boot(self, *, raw: bool, run_main: bool) -> None:
        """Starts an interpreter; raw: at the raw prompt, without main.py. Raises InterpreterMissing."""
        self._buffer.clear()
        self._answered = True
        told = self._for_runner(raw, run_main)
        self._interpreter = start(self._settings.interpreter, told)
        self._poll.register(self._interpreter.requests, select.POLLIN)

    def _for_runner(self, raw: bool, run_main: bool) -> dict[str, object]:
        """What a runner has to know: see there."""
        settings, clock, wanted = self._settings, self._clock, self._clock.settings
        runs = ["boot.py", "main.py"] if run_main and not raw else ["boot.py"] if raw else []
        return {
            "ops": op_codes(),
            "stepped": clock.stepped,
            "paced": clock.paced,
            "t0_ns": str(clock.zero_ns),
            "t_ns": clock.now(),
            "t_boot_ns": self._boot_ns,
            "ticks_start_us": wanted.ticks_start_us,
            "clock_ppm": wanted.ppm,
            "call_cost_ns": wanted.call_cost_us * 1000,
            "tick_cost_ns": wanted.tick_cost_us * 1000,
            "refresh_ns": STEPPED_REFRESH_NS if clock.stepped and not settings.emulated else USB_FRAME_NS,
            "pace": wanted.pace,
            "heap_bytes": settings.heap_bytes,
            "slack_bytes": _SLACK_BYTES,
            "epoch_ms": _EPOCH_MS,
            "frequency_hz": _FREQUENCY_HZ,
            "flash": str(self._folder),
            "flash_journal": str(self._journal) if self._journal else "",
            "raw": raw,
            "run": runs,
            "unique_id": settings.unique_id,
            "random_seed": settings.random_seed,
            **self._model.as_config(),
            **self._registers.as_config(),
            **(self._pico.for_runner() if self._pico is not None else {}),
        }

    @property
    def running(self) -> bool:
        """Whether an interpreter runs."""
        return self._interpreter is not None

    @property
    def asks(self) -> bool:
        """Whether bytes of a request have come."""
        return bool(self._buffer)

    @property
    def pid(self) -> int | None:
        """Process that runs the firmware now."""
        return self._interpreter.process.pid if self._interpreter is not None else None

    @property
    def cpu(self) -> float:
        """Processor time of all interpreters of this board so far, s."""
        return self._cpu + self._own_cpu()

    def kill(self) -> None:
        """Ends it at once, as a reset does: one that waits for an answer by that, to begin anew later."""
        interpreter = self._interpreter
        if interpreter is None:
            return
        self._poll.unregister(interpreter.requests)
        self._cpu += self._own_cpu()
        if self._settings.interpreter == "micropython" and not self._answered and not self._buffer:
            self.answer(0, FLAG_OVER, b"", 0.0, 0.0)
            interpreter.let_go()
        else:
            interpreter.kill()
        self._interpreter = None

    def owns(self, fd: int) -> bool:
        """Whether requests come through this descriptor."""
        return self._interpreter is not None and fd == self._interpreter.requests

    def take(self) -> None:
        """Takes what has come. Raises InterpreterDied: nothing comes any more."""
        assert self._interpreter is not None
        data = os.read(self._interpreter.requests, 1 << 17)
        if not data:
            self._died(self._interpreter)
        self._buffer += data

    def next_request(self) -> Request | None:
        """The next call, once all of it has come."""
        buffer = self._buffer
        if len(buffer) < REQUEST.size:
            return None
        op, interrupt_char, a, length, t = REQUEST.unpack_from(buffer)
        end = REQUEST.size + length
        if len(buffer) < end:
            return None
        payload = bytes(buffer[REQUEST.size : end])
        del buffer[:end]
        self._answered = False
        return Request(op, interrupt_char, a, payload, t)

    def answer(self, status: int, flags: int, payload: bytes, t: float, quiet: float) -> None:
        """Answers the last call, which is over at t; quiet: see RESPONSE."""
        assert self._interpreter is not None
        self._answered = True
        try:
            head = RESPONSE.pack(status, flags, 0, len(payload), t, quiet)
            os.write(self._interpreter.responses, head + payload)
        except BrokenPipeError:
            return

    def _own_cpu(self) -> float:
        """s of the interpreter that runs."""
        return 0.0 if self._interpreter is None else self._interpreter.cpu()

    def _died(self, interpreter: Interpreter) -> NoReturn:
        """Its pipe closed, which nothing the firmware does brings about."""
        self._poll.unregister(interpreter.requests)
        self._cpu += self._own_cpu()
        interpreter.process.wait()
        words = interpreter.last_words()
        status = interpreter.close()
        self._interpreter = None
        raise InterpreterDied(
            f"{self._settings.interpreter} ended with status {status} "
            f"at {self._clock.now() / NS_PER_S:.3f} s: {words or 'no message'}"
        )
