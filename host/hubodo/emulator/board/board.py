"""The virtual board: answers the interpreter's calls, keeps its time, and lets happen what is scripted."""

from __future__ import annotations

import os
import select
import socket
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.emulator.board import interpreter as interpreters
from hubodo.emulator.board.bus import I2cBus, Pins
from hubodo.emulator.board.calls import BOOT_NS, HANDLERS
from hubodo.emulator.board.hypercall import (
    EIO,
    ENODEV,
    FLAG_INPUT,
    FLAG_INTERRUPT,
    FLAG_OPEN,
    FLAG_PLUGGED,
    FLAG_ROOM,
    REQUEST,
    RESPONSE,
    op_codes,
)
from hubodo.emulator.board.link import TX_FIFO, LineNoise, Link, MemoryLink, PtyLink
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.network import Station
from hubodo.emulator.board.port import Port
from hubodo.emulator.board.reset_registers import ResetRegisters, Why
from hubodo.emulator.board.rp2040.pico import Pico
from hubodo.emulator.board.settings import BoardSettings
from hubodo.emulator.chips.faults import BrownOut, Fault, Reset, Stall, Unplug
from hubodo.emulator.chips.registers import RegisterChip

CTRL_C = 3
REPLUG_NS = 200_000_000
USB_FRAME_NS = 1_000_000
STEPPED_REFRESH_NS = 4_000_000
BUSY_NS = 2_000_000_000
CONSOLE_BYTE_NS, CONSOLE_FIFO = 10e9 / 115200, 128
_NS = 1_000_000_000
_FOREVER = float("inf")


@dataclass
class _Waiting:
    """A call whose answer has to wait for the link."""

    deadline: float
    finished: Callable[[bool], bool]


class VirtualBoard:
    """Chips, bus, pins, clock, watchdog and link of one node, and the interpreter that drives them.

    `serve` runs until `stop`, `run_for` or a fatal error. Not thread-safe: other threads talk to a board
    through the control connection given to `serve`.
    """

    def __init__(
        self,
        settings: BoardSettings,
        chips: Sequence[RegisterChip],
        link: Link,
        *,
        faults: Sequence[Fault] = (),
        noise: LineNoise | None = None,
    ) -> None:
        self.settings, self.chips, self.link = settings, tuple(chips), link
        self.noise = noise or LineNoise()
        self.model = MODELS[settings.model]
        self.bus = I2cBus(
            self.chips,
            faults,
            sda=self.model.sda,
            scl=self.model.scl,
            wiring=settings.wiring,
            refusal=EIO if self.model.platform == "rp2" else ENODEV,
        )
        self.pins = Pins(self.bus)
        self.counts: Counter[str] = Counter()
        self.calls: Counter[int] = Counter()
        self.resets: list[tuple[float, str]] = []
        self.link_log: list[tuple[int, bytes, bytes, bool]] | None = None
        self.running = False
        self.stepped = settings.clock != "real"
        self.paced = settings.clock == "paced"
        self.t = 0.0
        self._t0_ns = 0
        self._boot_ns = 0.0
        self._registers = ResetRegisters(self.model)
        self.ports: dict[int, Port] = {0: Port()}
        self.ports[self.link_port] = Port(link=link)
        if self.model.platform == "esp32":
            self.ports[0].byte_ns, self.ports[0].send_buffer = CONSOLE_BYTE_NS, CONSOLE_FIFO
        # In an emulated processor MicroPython itself looks for ctrl-C.
        self._emulated = settings.interpreter == "rp2040"
        self._first_interrupt_char = -1 if self._emulated else CTRL_C
        self._interrupt_char = self._first_interrupt_char
        self.meter: dict[str, Any] = {}
        self.interrupt_came = False
        self._interrupt_at = 0
        self.wdt_timeout = 0.0
        self.wdt_deadline = _FOREVER
        self._waiting: _Waiting | None = None
        self.station = Station(self.model.platform, settings.air)
        self.sockets: dict[int, socket.socket] = {}
        self.mail: dict[int, list[tuple[tuple[str, int], bytes]]] = {}
        """What the air itself has answered to a socket."""
        self._script = sorted(
            ((f.t * _NS, f) for f in faults if isinstance(f, Reset | Unplug) or _restarts(f)),
            key=lambda x: x[0],
        )
        self._stalls = sorted((f for f in faults if isinstance(f, Stall)), key=lambda f: f.t)
        if settings.run_for is not None:
            self._end = settings.run_for * _NS
        else:
            self._end = _FOREVER
        self._plug_at = _FOREVER
        self._interpreter: interpreters.Interpreter | None = None
        self._poll = select.poll()
        self._watched_link = -1
        self._buffer = bytearray()
        self._interpreter_cpu = 0.0
        self._pico: Pico | None = None

    @property
    def link_port(self) -> int:
        return 0 if self.settings.uart_link is None else self.settings.uart_link + 1

    # ---- time ----

    def now(self) -> float:
        """True time in ns since the board was switched on."""
        return self.t if self.stepped else time.monotonic_ns() - self._t0_ns

    # ---- life of the interpreter ----

    def boot(self, *, raw: bool = False, run_main: bool = True) -> None:
        self._buffer.clear()
        self._waiting = None
        self._interrupt_char = self._first_interrupt_char
        settings = self.settings
        started = self.now()
        self._interpreter = interpreters.start(
            settings.interpreter,
            {
                "ops": op_codes(),
                "stepped": self.stepped,
                "paced": self.paced,
                "t0_ns": str(self._t0_ns),
                "t_ns": started,
                "t_boot_ns": self._boot_ns,
                "ticks_start_us": settings.ticks_start_us,
                "clock_ppm": settings.clock_ppm,
                "call_cost_ns": settings.call_cost_us * 1000,
                "tick_cost_ns": settings.tick_cost_us * 1000,
                "refresh_ns": STEPPED_REFRESH_NS if self.stepped and not self._emulated else USB_FRAME_NS,
                "pace": settings.pace,
                "heap_bytes": settings.heap_bytes,
                "slack_bytes": 98304,
                "epoch_ms": 1_609_459_200_000,
                "flash": str(settings.flash),
                "raw": raw,
                "run": ["boot.py", "main.py"] if run_main and not raw else ["boot.py"] if raw else [],
                "unique_id": settings.unique_id,
                **self.model.as_config(),
                **self._registers.as_config(),
                "flash_journal": str(settings.flash_journal) if settings.flash_journal else "",
                "frequency_hz": 125_000_000,
                **(self._pico.for_runner() if self._pico is not None else {}),
            },
            tempfile.TemporaryFile(),
        )
        self._poll.register(self._interpreter.requests, select.POLLIN)

    def _account(self) -> None:
        """Add the ended or running interpreter's processor time."""
        assert self._interpreter is not None
        try:
            fields = (
                Path(f"/proc/{self._interpreter.process.pid}/stat").read_text().rpartition(")")[2].split()
            )
        except OSError:
            return
        self._interpreter_cpu += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    @property
    def interpreter_pid(self) -> int | None:
        """Process that runs the firmware now."""
        return self._interpreter.process.pid if self._interpreter is not None else None

    def interpreter_cpu(self) -> float:
        """Processor time of all interpreters of this board so far, s."""
        before = self._interpreter_cpu
        if self._interpreter is not None:
            self._account()
        total, self._interpreter_cpu = self._interpreter_cpu, before
        return total

    def kill(self) -> None:
        if self._interpreter is not None:
            self._poll.unregister(self._interpreter.requests)
            self._account()
            self._interpreter.kill()
            self._interpreter = None

    def reset(self, why: Why) -> None:
        """Restart the processor: USB goes away and comes back."""
        self.kill()
        self.resets.append((self.now() / _NS, why))
        self._registers.reset(why)
        self.wdt_deadline, self.wdt_timeout = _FOREVER, 0.0
        for port in self.ports.values():
            port.clear()
        self.interrupt_came = False
        self.pins = Pins(self.bus)
        for handle in list(self.sockets):
            self.sockets.pop(handle).close()
        self.mail.clear()
        self.station = Station(self.model.platform, self.settings.air)
        if self.stepped and not self._emulated:
            self.t += BOOT_NS
        self._boot_ns = self.now()
        self._leave_usb()
        self.boot()

    def restarted(self, why: str) -> None:
        """The emulated processor has reset itself: what the host sees of it."""
        self.resets.append((self.now() / _NS, why))
        self.ports[self.link_port].clear()
        self._leave_usb()

    def _leave_usb(self) -> None:
        if isinstance(self.link, PtyLink) and self.settings.uart_link is None:
            self._unplug(REPLUG_NS)

    def _ended(self) -> None:
        """The request pipe closed, which nothing the firmware does brings about."""
        assert self._interpreter is not None
        self._poll.unregister(self._interpreter.requests)
        self._account()
        self._interpreter.process.wait()
        words = self._interpreter.last_words()
        status = self._interpreter.close()
        self._interpreter = None
        raise interpreters.InterpreterDied(
            f"{self.settings.interpreter} ended with status {status} at {self.now() / _NS:.3f} s: "
            f"{words or 'no message'}"
        )

    # ---- the link ----

    def _unplug(self, back_after_ns: float = _FOREVER) -> None:
        if isinstance(self.link, PtyLink):
            self._forget_link()
            self.link.unplug()
            self.ports[self.link_port].to_send.clear()
            self.counts["unplugged"] += 1
            self._plug_at = self.now() + back_after_ns

    def unplug(self) -> None:
        """Pull the cable."""
        self._unplug()

    def plug(self) -> None:
        """Put the cable back; the terminal has a new name."""
        self._plug_at = _FOREVER
        if isinstance(self.link, PtyLink):
            self.link.plug()

    def _forget_link(self) -> None:
        if self._watched_link >= 0:
            self._poll.unregister(self._watched_link)
            self._watched_link = -1

    def watch_link(self) -> None:
        if not self.link.host_open:
            self._forget_link()
            return
        fd = self.link.fileno()
        if fd != self._watched_link:
            self._forget_link()
            self._poll.register(fd, select.POLLIN)
            self._watched_link = fd

    def take_input(self) -> None:
        if isinstance(self.link, MemoryLink):
            self.link.t = self.now() * 1e-9
        if self._emulated and self.ports[self.link_port].received:
            # USB lets the host wait where the device does not take its bytes.
            return
        data = self.link.read()
        if not data:
            return
        self.counts["bytes_in"] += len(data)
        port = self.ports[self.link_port]
        for byte in data:
            if byte == self._interrupt_char and self.link_port == 0:
                self._interrupted()
            elif len(port.received) < port.receive_buffer:
                port.received.append(byte)
            else:
                self.counts["bytes_in_dropped"] += 1

    def _interrupted(self) -> None:
        """The interrupt character came in: what waits before it is forgotten, as the ports do."""
        self.ports[0].received.clear()
        if not self.interrupt_came:
            self._interrupt_at = time.monotonic_ns()
        self.interrupt_came = True

    def send_waiting(self, port: Port) -> None:
        """As much of what waits as goes."""
        while port.on_wire and port.on_wire[0][0] <= self.now():
            port.to_send += port.on_wire.popleft()[1]
        if port.to_send and port.link is not None:
            n = port.link.write(bytes(port.to_send))
            del port.to_send[:n]

    # ---- service ----

    def serve(self, control: int = -1, on_control: Callable[[], None] | None = None) -> None:
        """Switch on and run; `on_control` is called whenever the descriptor `control` has input.

        Raises:
            InterpreterMissing, InterpreterDied, ChipAccessError: see there.
        """
        self.running = True
        if control >= 0:
            self._poll.register(control, select.POLLIN)
        try:
            while self.settings.wait_for_host and self.running and not self.link.host_open:
                self._serve_control(control, on_control, 10)
            power_on_ns = self.settings.power_on_ns
            # A paced interpreter loads before that and waits for the clock by itself, so as not to be late.
            while (
                power_on_ns is not None
                and not self.paced
                and self.running
                and time.monotonic_ns() < power_on_ns
            ):
                self._serve_control(control, on_control, 1)
            if self.running:
                if self._emulated:
                    self._pico = Pico(self.settings)
                self._t0_ns = time.monotonic_ns() if power_on_ns is None else power_on_ns
                self.boot()
            while self.running:
                self._turn(control, on_control)
        finally:
            self.running = False
            self.kill()
            self._forget_link()
            self.mirror_flash()

    def stop(self) -> None:
        """Switch off at the next turn of `serve`."""
        self.running = False

    def mirror_flash(self) -> None:
        """What an emulated Pico's flash chip holds, to the folder `flash`; other boards keep it there."""
        if self._pico is not None:
            self._pico.mirror()

    def _serve_control(self, control: int, on_control: Callable[[], None] | None, timeout_ms: float) -> None:
        for fd, _ in self._poll.poll(timeout_ms):
            if fd == control and on_control is not None:
                on_control()

    def _turn(self, control: int, on_control: Callable[[], None] | None) -> None:
        for fd, event in self._poll.poll(self._patience_ms()):
            if fd == control:
                if on_control is not None:
                    on_control()
            elif self._interpreter is not None and fd == self._interpreter.requests:
                data = os.read(fd, 1 << 17)
                if data:
                    self._buffer += data
                else:
                    self._ended()
            elif fd == self._watched_link:
                if event & select.POLLIN:
                    self.take_input()
                if event & (select.POLLHUP | select.POLLERR):
                    self.watch_link()
        if not self.stepped:
            self._happen(self.now())
        self._break_busy_loop()
        self._watch_link_now_and_then()
        port = self.ports[self.link_port]
        if port.to_send or port.on_wire:
            self.send_waiting(port)
        if self._waiting is not None:
            self._settle()
        while self.running and self._waiting is None and len(self._buffer) >= REQUEST.size:
            if not self._serve_one():
                break

    def _watch_link_now_and_then(self) -> None:
        now = time.monotonic()
        if now - self._looked > 0.005:
            self._looked = now
            self.watch_link()
            if isinstance(self.link, MemoryLink):
                self.take_input()

    _looked = 0.0

    def _patience_ms(self) -> float:
        if self._buffer and self._waiting is None:
            return 0
        if self.stepped:
            return 1 if self.paced and self._waiting is not None else 5
        due = min(
            self.wdt_deadline, self._plug_at, self._end, self._script[0][0] if self._script else _FOREVER
        )
        if self._waiting is not None:
            due = min(due, self._waiting.deadline)
        port = self.ports[self.link_port]
        if port.on_wire:
            due = min(due, port.on_wire[0][0])
        limit = 5.0 if port.to_send else 20.0
        return max(0.0, min(limit, (due - self.now()) / 1e6 + 0.5))

    def _break_busy_loop(self) -> None:
        """A loop that calls nothing cannot be told of ctrl-C in this build: it ends, and the prompt comes."""
        if (
            self.interrupt_came
            and self._interpreter is not None
            and time.monotonic_ns() - self._interrupt_at > BUSY_NS
        ):
            self.counts["broken_loops"] += 1
            self.kill()
            self.interrupt_came = False
            self.ports[0].to_send += b"KeyboardInterrupt: \r\n"
            self.boot(run_main=False)

    def _happen(self, t: float) -> bool:
        """Let happen what is due; True when the processor was restarted or switched off."""
        if t >= self._end:
            self.running = False
            return True
        if t >= self._plug_at:
            self.plug()
        while self._script and self._script[0][0] <= t:
            _, fault = self._script.pop(0)
            if isinstance(fault, Unplug):
                self._unplug(fault.seconds * _NS)
            else:
                self.reset("brown-out" if isinstance(fault, BrownOut) else "reset pin")
                return True
        if t >= self.wdt_deadline:
            self.reset("watchdog")
            return True
        return False

    def _serve_one(self) -> bool:
        buffer = self._buffer
        op, interrupt, a, length, t = REQUEST.unpack_from(buffer)
        if len(buffer) < REQUEST.size + length:
            return False
        payload = bytes(buffer[REQUEST.size : REQUEST.size + length])
        del buffer[: REQUEST.size + length]
        if interrupt != self._interrupt_char:
            self._interrupt_char = interrupt
            if interrupt in self.ports[0].received:
                # It came after the code that wants it had begun, before this call could say so.
                self._interrupted()
        self.t = t
        self.calls[op] += 1
        if self.stepped:
            if isinstance(self.link, MemoryLink):
                self.take_input()
            if self._happen(t):
                return False
        HANDLERS[op](self, a, payload, t)
        return self._interpreter is not None

    def answer(self, status: int, t: float, payload: bytes = b"") -> None:
        assert self._interpreter is not None
        while self._stalls and self._stalls[0].t * _NS <= t:
            t += self._stalls.pop(0).seconds * _NS
            self.counts["stalls"] += 1
        flags = 0
        port = self.ports[0]
        if port.received:
            flags |= FLAG_INPUT
        if len(port.to_send) < TX_FIFO or self.model.platform == "esp32":
            flags |= FLAG_ROOM
        if self.interrupt_came:
            flags |= FLAG_INTERRUPT
            self.interrupt_came = False
        if self.link.host_open:
            flags |= FLAG_OPEN
        if self.link.plugged:
            flags |= FLAG_PLUGGED
        try:
            os.write(self._interpreter.responses, RESPONSE.pack(status, flags, 0, len(payload), t) + payload)
        except BrokenPipeError:
            return

    def answer_later(self, timeout_ns: float, finished: Callable[[bool], bool]) -> None:
        """Answer later: `finished(late)` answers and returns True once it can, at the latest when late."""
        if finished(False):
            return
        self._waiting = _Waiting(self.now() + timeout_ns, finished)

    def _settle(self) -> None:
        assert self._waiting is not None
        waiting = self._waiting
        if self._interpreter is None:
            self._waiting = None
            return
        late = self.now() >= waiting.deadline
        if self.stepped and not late:
            # Virtual time passes in the wait; a host on a terminal gets a little real time to answer.
            passed = (
                (time.monotonic_ns() - self._t0_ns) / self.settings.pace
                if self.paced
                else self.t + 20_000_000
            )
            self.t = max(self.t, min(waiting.deadline, passed))
            self.take_input()
            late = self.t >= waiting.deadline
            if self._happen(self.t):
                return
        if waiting.finished(late) or late:
            self._waiting = None


def _restarts(fault: Fault) -> bool:
    return isinstance(fault, BrownOut) and fault.of == "board"
