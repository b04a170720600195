"""The virtual board: answers the interpreter's calls, keeps its time, and lets happen what is scripted."""

from __future__ import annotations

import json
import select
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hubodo.emulator.board.bus import I2cBus
from hubodo.emulator.board.clock import FOREVER, BoardClock
from hubodo.emulator.board.hypercall import EIO, ENODEV, Handler, Op, Reply
from hubodo.emulator.board.lead import Lead
from hubodo.emulator.board.link import HostLink, LineNoise
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.peripherals import Peripherals
from hubodo.emulator.board.processor import Processor, Request
from hubodo.emulator.board.radio import RadioModule
from hubodo.emulator.board.reset_registers import Why
from hubodo.emulator.board.schedule import Schedule
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Wiring
from hubodo.emulator.board.sockets import Network
from hubodo.emulator.board.streams import Streams
from hubodo.emulator.chips.faults import BrownOut, ScriptedFault, Unplug
from hubodo.emulator.chips.registers import RegisterChip
from hubodo.units import NS_PER_S

REPLUG_NS = 200_000_000
BOOT_NS = 150_000_000


@dataclass
class _Waiting:
    """A call whose answer has to wait for the link."""

    deadline: float
    finished: Callable[[bool], Reply | None]


class VirtualBoard:
    """Chips, bus, pins, clock, watchdog and link of one node, and the interpreter that drives them.

    The folder of `flash` is its file system. `serve` runs until `stop`, the clock's `run_for` or a fatal
    error. Not thread-safe: other threads talk to a board through the control connection given to `serve`.
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
        wait_for_host: bool = False,
        faults: Sequence[ScriptedFault] = (),
        radio: RadioModule | None = None,
    ) -> None:
        self.running = False
        self.counts: Counter[str] = Counter()
        self.calls: Counter[int] = Counter()
        self.resets: list[tuple[float, str]] = []
        self.meter: dict[str, Any] = {}
        self._settings, self._wait_for_host = settings, wait_for_host
        model = MODELS[settings.model]
        self._clock = BoardClock(clock)
        self._schedule = Schedule(faults, clock.run_for)
        refusal = EIO if model.platform == "rp2" else ENODEV
        self.bus = I2cBus(chips, faults, sda=model.sda, scl=model.scl, wiring=wiring, refusal=refusal)
        self._poll = select.poll()
        self.processor = Processor(settings, self._clock, flash, self._poll)
        self._network = Network(model, settings.air, self._clock, self.counts)
        waits = self._network.waits
        self.streams = Streams(settings, model, link, noise, self._clock, self._poll, self.counts, waits)
        self.lead = Lead(self._clock, link)
        self._radio = radio
        self._peripherals = Peripherals(model, self.bus, settings.battery_mv, self._network.radio_on, radio)
        self._handlers = self._own_handlers()
        for part in (self._schedule, self._peripherals, self.streams, self._network):
            self._handlers |= part.handlers()
        self._waiting: _Waiting | None = None
        self._control: tuple[int, Callable[[], None]] = (-1, lambda: None)

    @property
    def seconds(self) -> float:
        """True time since it was switched on, s."""
        return self._clock.now() / NS_PER_S

    def reset(self, why: Why) -> None:
        """Restart the processor: USB goes away and comes back."""
        self.processor.kill()
        self.resets.append((self.seconds, why))
        self._schedule.stop_watchdog()
        self.streams.reset()
        self._peripherals.reset()
        self._network.reset()
        if self._clock.stepped and not self._settings.emulated:
            self._clock.t += BOOT_NS
        if self.streams.usb:
            self.unplug(REPLUG_NS)
        self.processor.restarted(why)
        self._boot()

    def _boot(self, *, raw: bool = False, run_main: bool = True) -> None:
        self._waiting = None
        self.lead.forget()
        self.streams.begin()
        self.processor.boot(raw=raw, run_main=run_main)

    def unplug(self, back_after_ns: float = FOREVER) -> None:
        """Pull the cable, for a while or for good."""
        if self.streams.unplug():
            self._schedule.plug_at = self._clock.now() + back_after_ns

    def plug(self) -> None:
        """Put the cable back."""
        self._schedule.plug_at = FOREVER
        self.streams.plug()

    # ---- service ----

    def serve(self, control: int = -1, on_control: Callable[[], None] = lambda: None) -> None:
        """Switch on and run; `on_control` is called whenever the descriptor `control` has input.

        Raises:
            InterpreterMissing, InterpreterDied, ChipAccessError: see there.
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
                self._turn()
                self.lead.look(waits=self._waiting is not None)
        finally:
            self.running = False
            if self._radio is not None:
                self._radio.end()
            self.processor.kill()
            self.streams.forget_terminal()
            self.processor.mirror_flash()

    def stop(self) -> None:
        """Switch off at the next turn of `serve`."""
        self.running = False

    def _await_power(self) -> None:
        """Waits for a host where that is wanted, and for the moment the clock names."""
        while self._wait_for_host and self.running and not self.streams.link.host_open:
            self._serve_control(10)
        power_on_ns = self._clock.settings.power_on_ns
        # A paced interpreter loads before that and waits for the clock by itself, so as not to be late.
        if power_on_ns is not None and not self._clock.paced:
            while self.running and time.monotonic_ns() < power_on_ns:
                self._serve_control(1)

    def _serve_control(self, timeout_ms: float) -> None:
        fd, on_control = self._control
        for ready, _ in self._poll.poll(timeout_ms):
            if ready == fd:
                on_control()

    def _turn(self) -> None:
        control, on_control = self._control
        for fd, event in self._poll.poll(self._patience_ms()):
            if fd == control:
                on_control()
            elif self.processor.owns(fd):
                self.processor.take()
            elif fd == self.streams.watched:
                self.streams.happened(event)
        if not self._clock.stepped:
            self._happen(self._clock.now())
        self._break_busy_loop()
        self.streams.watch_now_and_then()
        self.streams.send_waiting()
        if self._waiting is not None:
            self._settle(self._waiting)
        self.lead.note_written()
        while self.running and self._waiting is None:
            request = self.lead.next_call(self.processor.next_request)
            if request is None:
                break
            self._serve(request)
            self.lead.note_written()

    def _patience_ms(self) -> float:
        if self.processor.asks and self._waiting is None:
            return 0
        if self._clock.stepped:
            return 1 if self._clock.paced and self._waiting is not None else 5
        due = min(self._schedule.next, self.streams.due)
        if self._waiting is not None:
            due = min(due, self._waiting.deadline)
        limit = 5.0 if self.streams.sending else 20.0
        return max(0.0, min(limit, (due - self._clock.now()) / 1e6 + 0.5))

    def _break_busy_loop(self) -> None:
        """A loop that calls nothing cannot be told of ctrl-C in this build: it ends, and the prompt comes."""
        if self.processor.running and self.streams.interrupt_unheard():
            self.counts["broken_loops"] += 1
            self.processor.kill()
            self.streams.interrupt_came = False
            self.streams.say(b"KeyboardInterrupt: \r\n")
            self._boot(run_main=False)

    def _happen(self, t: float) -> bool:
        """Let happen what is due; True when the processor was restarted or switched off."""
        schedule = self._schedule
        if t >= schedule.end:
            self.running = False
            return True
        if t >= schedule.plug_at:
            self.plug()
        while (fault := schedule.due(t)) is not None:
            if not isinstance(fault, Unplug):
                self.reset("brown-out" if isinstance(fault, BrownOut) else "reset pin")
                return True
            self.unplug(fault.seconds * NS_PER_S)
        if t >= schedule.watchdog_at:
            self.reset("watchdog")
            return True
        return False

    def _serve(self, request: Request) -> None:
        op, interrupt_char, a, payload, t = request
        self.streams.heed(interrupt_char)
        self._clock.t = t
        self.calls[op] += 1
        if self._clock.stepped:
            self.streams.take_script()
            if self._happen(t):
                return
        done = self._handlers[op](a, payload, t)
        if isinstance(done, Reply):
            self._answer(done)
        elif done is not None:
            answer = done.finished(False)
            if answer is not None:
                self._answer(answer)
            else:
                self._waiting = _Waiting(self._clock.now() + done.timeout_ns, done.finished)

    def _answer(self, answer: Reply) -> None:
        count, t = self._schedule.stall(answer.t)
        if count:
            self.counts["stalls"] += count
        quiet = min(self._schedule.quiet, self.streams.quiet) if self._clock.stepped else 0.0
        if self._radio is not None:
            self._radio.reached(t)
        self.processor.answer(answer.status, self.streams.flags(), answer.payload, t, quiet)

    def _settle(self, waiting: _Waiting) -> None:
        """Answers the call that waits, if it can be or is late."""
        clock = self._clock
        late = clock.now() >= waiting.deadline
        if clock.stepped and not late:
            clock.wait_until(waiting.deadline)
            self.streams.take_input()
            late = clock.t >= waiting.deadline
            if self._happen(clock.t):
                return
        answer = waiting.finished(late)
        if answer is not None:
            self._answer(answer)
        if answer is not None or late:
            self._waiting = None

    def _own_handlers(self) -> dict[int, Handler]:
        return {
            Op.PING: lambda a, payload, t: Reply(t),
            Op.RESET: self._reset,
            Op.SOFT_RESET: self._soft_reset,
            Op.RESTARTED: self._restarted,
            Op.IDLE: self._at_prompt,
            Op.METER: self._metered,
        }

    def _reset(self, a: int, payload: bytes, t: float) -> None:
        self.reset("machine.reset")

    def _soft_reset(self, a: int, payload: bytes, t: float) -> None:
        self.processor.kill()
        self.counts["soft_resets"] += 1
        if self._clock.stepped:
            self._clock.t += BOOT_NS
        self._boot(raw=bool(a))

    def _restarted(self, a: int, payload: bytes, t: float) -> Reply:
        """The emulated processor has reset itself: what the host sees of it."""
        self.resets.append((self.seconds, "machine.reset" if a & 2 else "watchdog"))
        self.streams.forget_link()
        if self.streams.usb:
            self.unplug(REPLUG_NS)
        return Reply(t)

    def _at_prompt(self, a: int, payload: bytes, t: float) -> Reply:
        self.counts["at_prompt"] += 1
        return Reply(t)

    def _metered(self, a: int, payload: bytes, t: float) -> Reply:
        self.meter = json.loads(payload)
        return Reply(t)
