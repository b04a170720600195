"""The processor of a board: its interpreter, the settings at each start, and its calls and replies."""

from __future__ import annotations

import os
import select
from typing import NamedTuple, NoReturn

from hubodo.emulator.board.clock import BoardClock
from hubodo.emulator.board.hypercall import FLAG_BOARD_OFF, REQUEST, RESPONSE, op_codes
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.reset_registers import ResetCause, ResetRegisters
from hubodo.emulator.board.settings import BoardSettings, Flash
from hubodo.emulator.interpreters.interpreter import Interpreter, InterpreterDied, start_interpreter
from hubodo.emulator.interpreters.rp2040.pico import Pico
from hubodo.units import NS_PER_S

USB_FRAME_NS = 1_000_000
STEPPED_REFRESH_NS = 4_000_000
_HEAP_SLACK_BYTES = 98304
_EPOCH_MS = 1_609_459_200_000
_FREQUENCY_HZ = 125_000_000


class Request(NamedTuple):
    """A call of the interpreter at `t` ns."""

    op: int
    interrupt_char: int
    argument: int
    payload: bytes
    t: float


class Processor:
    """The current interpreter of a board; its requests are registered at `poll`."""

    def __init__(self, settings: BoardSettings, clock: BoardClock, flash: Flash, poll: select.poll) -> None:
        assert flash.folder is not None
        self._settings, self._clock, self._poll = settings, clock, poll
        self._folder, self._journal = flash.folder, flash.journal
        self._model = MODELS[settings.model]
        self._reset_registers = ResetRegisters(self._model)
        self._boot_ns = 0.0
        self._pico: Pico | None = None
        self._interpreter: Interpreter | None = None
        self._buffer = bytearray()
        self._has_replied = True
        self._cpu = 0.0

    def power_on(self) -> None:
        """Prepare the flash of an emulated Pico. Raise ImageMissing or FlashUnreadable, see `Pico`."""
        if self._settings.is_emulated:
            self._pico = Pico(self._settings.pico, self._folder)

    def mirror_flash(self) -> None:
        """Copy the files in the flash of an emulated Pico to its folder.

        Other boards use the folder itself.
        """
        if self._pico is not None:
            self._pico.mirror()

    def record_reset(self, cause: ResetCause) -> None:
        """Record a reset: its cause in the registers, and the time of the next start."""
        self._reset_registers.reset(cause)
        self._boot_ns = self._clock.now()

    def boot(self, *, raw: bool, run_main: bool) -> None:
        """Start an interpreter. Raise InterpreterMissing.

        raw: at the raw prompt, without main.py.
        """
        self._buffer.clear()
        self._has_replied = True
        runner_settings = self._runner_settings(raw, run_main)
        self._interpreter = start_interpreter(self._settings.interpreter, runner_settings)
        self._poll.register(self._interpreter.requests, select.POLLIN)

    def _runner_settings(self, raw: bool, run_main: bool) -> dict[str, object]:
        """Return the settings of the runner."""
        settings, clock, clock_settings = self._settings, self._clock, self._clock.settings
        files = ["boot.py", "main.py"] if run_main and not raw else ["boot.py"] if raw else []
        return {
            "ops": op_codes(),
            "stepped": clock.stepped,
            "paced": clock.paced,
            "t0_ns": str(clock.zero_ns),
            "t_ns": clock.now(),
            "t_boot_ns": self._boot_ns,
            "ticks_start_us": clock_settings.ticks_start_us,
            "clock_ppm": clock_settings.ppm,
            "sleep_ppm": clock_settings.sleep_ppm,
            "call_cost_ns": clock_settings.call_cost_us * 1000,
            "tick_cost_ns": clock_settings.tick_cost_us * 1000,
            "refresh_ns": STEPPED_REFRESH_NS if clock.stepped and not settings.is_emulated else USB_FRAME_NS,
            "pace": clock_settings.pace,
            "heap_bytes": settings.heap_bytes,
            "slack_bytes": _HEAP_SLACK_BYTES,
            "epoch_ms": _EPOCH_MS,
            "frequency_hz": _FREQUENCY_HZ,
            "flash": str(self._folder),
            "flash_journal": str(self._journal) if self._journal else "",
            "raw": raw,
            "run": files,
            "unique_id": settings.unique_id,
            "random_seed": settings.random_seed,
            **self._model.as_config(),
            **self._reset_registers.as_config(),
            **(self._pico.runner_settings() if self._pico is not None else {}),
        }

    @property
    def is_running(self) -> bool:
        """True if an interpreter is running."""
        return self._interpreter is not None

    @property
    def has_partial_request(self) -> bool:
        """True if bytes of a request have been received."""
        return bool(self._buffer)

    @property
    def pid(self) -> int | None:
        """Process that runs the firmware, or None."""
        return self._interpreter.process.pid if self._interpreter is not None else None

    @property
    def cpu(self) -> float:
        """Processor time of all interpreters of this board, s."""
        return self._cpu + self._own_cpu()

    def kill(self) -> None:
        """End the interpreter at once, as a reset does.

        One that waits for a reply is informed that its board is off, and is released for reuse.
        """
        interpreter = self._interpreter
        if interpreter is None:
            return
        self._poll.unregister(interpreter.requests)
        self._cpu += self._own_cpu()
        if self._settings.interpreter == "micropython" and not self._has_replied and not self._buffer:
            self.answer(0, FLAG_BOARD_OFF, b"", 0.0, 0.0)
            interpreter.release()
        else:
            interpreter.kill()
        self._interpreter = None

    def owns(self, fd: int) -> bool:
        """Return True if requests are received through this descriptor."""
        return self._interpreter is not None and fd == self._interpreter.requests

    def read_requests(self) -> None:
        """Read the available bytes of requests. Raise InterpreterDied if the pipe is closed."""
        assert self._interpreter is not None
        data = os.read(self._interpreter.requests, 1 << 17)
        if not data:
            self._raise_died(self._interpreter)
        self._buffer += data

    def next_request(self) -> Request | None:
        """Return the next complete call, or None."""
        buffer = self._buffer
        if len(buffer) < REQUEST.size:
            return None
        op, interrupt_char, argument, length, t = REQUEST.unpack_from(buffer)
        end = REQUEST.size + length
        if len(buffer) < end:
            return None
        payload = bytes(buffer[REQUEST.size : end])
        del buffer[:end]
        self._has_replied = False
        return Request(op, interrupt_char, argument, payload, t)

    def answer(self, status: int, flags: int, payload: bytes, t: float, quiet: float) -> None:
        """Reply to the last call, which ends at t; quiet: see RESPONSE."""
        assert self._interpreter is not None
        self._has_replied = True
        try:
            head = RESPONSE.pack(status, flags, 0, len(payload), t, quiet)
            os.write(self._interpreter.responses, head + payload)
        except BrokenPipeError:
            return

    def _own_cpu(self) -> float:
        """Return the processor time of the current interpreter, s."""
        return 0.0 if self._interpreter is None else self._interpreter.cpu()

    def _raise_died(self, interpreter: Interpreter) -> NoReturn:
        """Raise InterpreterDied with its last output: its pipe closed, which no firmware can cause."""
        self._poll.unregister(interpreter.requests)
        self._cpu += self._own_cpu()
        interpreter.process.wait()
        last_log_lines = interpreter.last_log_lines()
        status = interpreter.close()
        self._interpreter = None
        raise InterpreterDied(
            f"{self._settings.interpreter} ended with status {status} "
            f"at {self._clock.now() / NS_PER_S:.3f} s: {last_log_lines or 'no message'}"
        )
