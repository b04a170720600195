"""The virtual board: it serves calls of the interpreter, keeps time and applies scheduled events."""

from __future__ import annotations

import json
import select
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from hubodo.emulator.board.bus import I2cBus
from hubodo.emulator.board.clock import FOREVER, BoardClock
from hubodo.emulator.board.hypercall import EIO, ENODEV, Handler, Op, Reply
from hubodo.emulator.board.link import HostLink, LineNoise
from hubodo.emulator.board.lockstep import LockstepControl
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.peripherals import Peripherals
from hubodo.emulator.board.processor import Processor, Request
from hubodo.emulator.board.radio import RadioModule
from hubodo.emulator.board.reset_registers import ResetCause
from hubodo.emulator.board.schedule import EventSchedule
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Wiring
from hubodo.emulator.board.sockets import BoardNetwork
from hubodo.emulator.board.spi_sensor import SpiSensor
from hubodo.emulator.board.streams import BoardStreams
from hubodo.emulator.chips.faults import BrownOut, ScriptedFault, Unplug
from hubodo.emulator.chips.registers import RegisterChip
from hubodo.units import NS_PER_S

REPLUG_NS = 200_000_000
BOOT_NS = 150_000_000


@dataclass
class _WaitingCall:
    """A call whose reply is delayed until its deadline, in ns, or until `finished` returns one."""

    deadline: float
    poll_reply: Callable[[bool], Reply | None]


class VirtualBoard:
    """Chips, bus, pins, clock, watchdog, link and interpreter of one node.

    The folder of `flash` is its file system. `serve` runs until `stop`, until `run_for` of the clock, or
    until a fatal error. Not thread-safe: other threads use the control connection given to `serve`.
    """

    def __init__(
        self,
        settings: BoardSettings,
        clock: Clock,
        flash: Flash,
        chips: Sequence[RegisterChip],
        link: HostLink,
        noise: LineNoise,
        *,
        wiring: Wiring = "good",
        interrupts: Mapping[int, Callable[[float], int]] = MappingProxyType({}),
        wait_for_host: bool = False,
        faults: Sequence[ScriptedFault] = (),
        radio: RadioModule | None = None,
        spi_sensor: SpiSensor | None = None,
    ) -> None:
        self.running = False
        self.counts: Counter[str] = Counter()
        self.calls: Counter[int] = Counter()
        self.resets: list[tuple[float, str]] = []
        self.profile: dict[str, Any] = {}
        self._settings, self._wait_for_host = settings, wait_for_host
        model = MODELS[settings.model]
        self._clock = BoardClock(clock)
        self._schedule = EventSchedule(faults, clock.run_for)
        refusal = EIO if model.platform == "rp2" else ENODEV
        self.bus = I2cBus(
            chips,
            faults,
            sda=model.sda,
            scl=model.scl,
            wiring=wiring,
            refusal=refusal,
            interrupts=interrupts,
        )
        self._poll = select.poll()
        self.processor = Processor(settings, self._clock, flash, self._poll)
        self._network = BoardNetwork(model, settings.wifi, self._clock, self.counts)
        has_datagram = self._network.has_datagram
        self.streams = BoardStreams(
            settings, model, link, noise, self._clock, self._poll, self.counts, has_datagram
        )
        self.lockstep = LockstepControl(self._clock, link)
        self._radio = radio
        self._peripherals = Peripherals(
            model,
            self.bus,
            lambda: settings.battery_mv + settings.battery_mv_per_s * self.seconds,
            self._network.is_radio_on,
            radio,
            spi_sensor=spi_sensor,
            now=self._clock.now,
            counts=self.counts,
        )
        self._handlers = self._own_handlers()
        for component in (self._schedule, self._peripherals, self.streams, self._network):
            self._handlers |= component.handlers()
        self._waiting: _WaitingCall | None = None
        self._control: tuple[int, Callable[[], None]] = (-1, lambda: None)

    @property
    def seconds(self) -> float:
        """True time since power-on, s."""
        return self._clock.now() / NS_PER_S

    def reset(self, cause: ResetCause) -> None:
        """Restart the processor; USB disconnects and reconnects."""
        self.processor.kill()
        self.resets.append((self.seconds, cause))
        self._schedule.stop_watchdog()
        self.streams.reset()
        self._peripherals.reset()
        self._network.reset()
        if self._clock.stepped and not self._settings.is_emulated:
            self._clock.t += BOOT_NS
        if self.streams.is_usb:
            self.unplug(REPLUG_NS)
        self.processor.record_reset(cause)
        self._boot()

    def _boot(self, *, raw: bool = False, run_main: bool = True) -> None:
        """Start the interpreter."""
        self._waiting = None
        self.lockstep.discard_call()
        self.streams.start_interpreter()
        self.processor.boot(raw=raw, run_main=run_main)

    def unplug(self, back_after_ns: float = FOREVER) -> None:
        """Unplug the cable, for a time or for good."""
        if self.streams.unplug():
            self._schedule.plug_at = self._clock.now() + back_after_ns

    def plug(self) -> None:
        """Plug the cable in again."""
        self._schedule.plug_at = FOREVER
        self.streams.plug()

    def serve(self, control: int = -1, on_control: Callable[[], None] = lambda: None) -> None:
        """Switch the board on and run it; call `on_control` whenever the descriptor `control` has input.

        Raise InterpreterMissing, InterpreterDied or ChipAccessError.
        """
        self.running = True
        self._control = (control, on_control)
        if control >= 0:
            self._poll.register(control, select.POLLIN)
        try:
            self._await_power()
            if self.running:
                self.processor.power_on()
                self._clock.switch_on()
                self._boot()
            while self.running:
                self._run_once()
                self.lockstep.check_limit(in_call=self._waiting is not None)
        finally:
            self.running = False
            if self._radio is not None:
                self._radio.switch_off()
            self.processor.kill()
            self.streams.unwatch_terminal()
            self.processor.mirror_flash()

    def stop(self) -> None:
        """Switch the board off at the next iteration of `serve`."""
        self.running = False

    def _await_power(self) -> None:
        """Wait for a host if required, and for the power-on time of the clock."""
        while self._wait_for_host and self.running and not self.streams.link.is_host_open:
            self._serve_control(10)
        power_on_ns = self._clock.settings.power_on_ns
        # With a paced clock the interpreter loads earlier and waits for the clock itself, to be on time.
        if power_on_ns is not None and not self._clock.paced:
            while self.running and time.monotonic_ns() < power_on_ns:
                self._serve_control(1)

    def _serve_control(self, timeout_ms: float) -> None:
        """Handle control input; wait for it for at most `timeout_ms`."""
        fd, on_control = self._control
        for ready, _ in self._poll.poll(timeout_ms):
            if ready == fd:
                on_control()

    def _run_once(self) -> None:
        """Run one iteration of `serve`: wait for input, apply due events, and serve calls."""
        control, on_control = self._control
        for fd, event in self._poll.poll(self._poll_timeout_ms()):
            if fd == control:
                on_control()
            elif self.processor.owns(fd):
                self.processor.read_requests()
            elif fd == self.streams.watched:
                self.streams.handle_poll_event(event)
        if not self._clock.stepped:
            self._run_due_events(self._clock.now())
        self._break_busy_loop()
        self.streams.poll_host()
        self.streams.send_pending()
        if self._waiting is not None:
            self._finish_waiting_call(self._waiting)
        self.lockstep.record_output()
        while self.running and self._waiting is None:
            request = self.lockstep.next_call(self.processor.next_request)
            if request is None:
                break
            self._serve_call(request)
            self.lockstep.record_output()

    def _poll_timeout_ms(self) -> float:
        """Return the timeout of the next poll, ms."""
        if self.processor.has_partial_request and self._waiting is None:
            return 0
        if self._clock.stepped:
            return 1 if self._clock.paced and self._waiting is not None else 5
        next_event = min(self._schedule.next_time, self.streams.next_uart_time)
        if self._waiting is not None:
            next_event = min(next_event, self._waiting.deadline)
        limit = 5.0 if self.streams.has_pending_output else 20.0
        return max(0.0, min(limit, (next_event - self._clock.now()) / 1e6 + 0.5))

    def _break_busy_loop(self) -> None:
        """Restart an interpreter that ignores ctrl-C.

        A loop without calls cannot be interrupted in this build of MicroPython.
        """
        if self.processor.is_running and self.streams.is_interrupt_ignored():
            self.counts["broken_loops"] += 1
            self.processor.kill()
            self.streams.interrupt_pending = False
            self.streams.print_text(b"KeyboardInterrupt: \r\n")
            self._boot(run_main=False)

    def _run_due_events(self, t: float) -> bool:
        """Apply the events that are due at t; return True if the processor restarted or the board is off."""
        schedule = self._schedule
        if t >= schedule.end:
            self.running = False
            return True
        if t >= schedule.plug_at:
            self.plug()
        while (fault := schedule.pop_due_fault(t)) is not None:
            if not isinstance(fault, Unplug):
                self.reset("brown-out" if isinstance(fault, BrownOut) else "reset pin")
                return True
            self.unplug(fault.seconds * NS_PER_S)
        if t >= schedule.watchdog_at:
            self.reset("watchdog")
            return True
        return False

    def _serve_call(self, request: Request) -> None:
        """Serve a call of the interpreter."""
        op, interrupt_char, argument, payload, t = request
        self.streams.set_interrupt_char(interrupt_char)
        self._clock.t = t
        self.calls[op] += 1
        if self._clock.stepped:
            self.streams.read_script()
            if self._run_due_events(t):
                return
        result = self._handlers[op](argument, payload, t)
        if isinstance(result, Reply):
            self._reply(result)
        elif result is not None:
            reply = result.poll_reply(False)
            if reply is not None:
                self._reply(reply)
            else:
                self._waiting = _WaitingCall(self._clock.now() + result.timeout_ns, result.poll_reply)

    def _reply(self, reply: Reply) -> None:
        """Send a reply, delayed by scripted stalls."""
        count, t = self._schedule.apply_stalls(reply.t)
        if count:
            self.counts["stalls"] += count
        quiet_until = (
            min(self._schedule.quiet_until, self.streams.quiet_until) if self._clock.stepped else 0.0
        )
        if self._radio is not None:
            self._radio.advance(t)
        self.processor.answer(reply.status, self.streams.flags(), reply.payload, t, quiet_until)

    def _finish_waiting_call(self, waiting: _WaitingCall) -> None:
        """Reply to the delayed call if its result is available or its deadline has passed."""
        clock = self._clock
        is_late = clock.now() >= waiting.deadline
        if clock.stepped and not is_late:
            clock.wait_until(waiting.deadline)
            self.streams.read_input()
            is_late = clock.t >= waiting.deadline
            if self._run_due_events(clock.t):
                return
        reply = waiting.poll_reply(is_late)
        if reply is not None:
            self._reply(reply)
        if reply is not None or is_late:
            self._waiting = None

    def _own_handlers(self) -> dict[int, Handler]:
        """Return the handlers of the calls served here."""
        return {
            Op.PING: lambda argument, payload, t: Reply(t),
            Op.RESET: self._reset,
            Op.SOFT_RESET: self._soft_reset,
            Op.RESTARTED: self._restarted,
            Op.IDLE: self._at_prompt,
            Op.METER: self._metered,
        }

    def _reset(self, argument: int, payload: bytes, t: float) -> None:
        self.reset("machine.reset")

    def _soft_reset(self, argument: int, payload: bytes, t: float) -> None:
        self.processor.kill()
        self.counts["soft_resets"] += 1
        if self._clock.stepped:
            self._clock.t += BOOT_NS
        self._boot(raw=bool(argument))

    def _restarted(self, argument: int, payload: bytes, t: float) -> Reply:
        """Apply the visible effects of a restart of the emulated processor by itself."""
        self.resets.append((self.seconds, "machine.reset" if argument & 2 else "watchdog"))
        self.streams.clear_link()
        if self.streams.is_usb:
            self.unplug(REPLUG_NS)
        return Reply(t)

    def _at_prompt(self, argument: int, payload: bytes, t: float) -> Reply:
        self.counts["at_prompt"] += 1
        return Reply(t)

    def _metered(self, argument: int, payload: bytes, t: float) -> Reply:
        self.profile = json.loads(payload)
        return Reply(t)
