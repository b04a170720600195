"""One node as the recorder knows it: its decoder, its clock, what to ask it, and its place in the log."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import assert_never

import numpy as np

from hubodo.ingest.node.bias_filter import filter_columns
from hubodo.ingest.node.clock import ClockSync
from hubodo.ingest.node.decoder import Output
from hubodo.ingest.node.exchanges import Exchanges
from hubodo.ingest.node.gaps import GapsSeen, LinkCounts
from hubodo.ingest.node.health import Supplies, supply
from hubodo.ingest.node.identity import hello_metadata
from hubodo.ingest.node.life_events import clock_found, last_report, switched_on
from hubodo.ingest.node.many_frames import NodeFrames
from hubodo.ingest.node.published import ArrivalOrder, Published, RateWindow
from hubodo.ingest.node.questions import Questions, reason_words
from hubodo.ingest.node.runs import RunDecoder
from hubodo.ingest.node.samples import (
    AnswerSeen,
    FilterSeen,
    HealthSeen,
    HelloSeen,
    ImuBlock,
    ImuRun,
    MagSample,
    Refused,
    SignalSeen,
    TimeReplySeen,
)
from hubodo.ingest.node.steady_times import SteadyTimes
from hubodo.ingest.sink import Sink
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire import FINGERPRINT, Frame, Message, node_name
from hubowire.messages import (
    GetHello,
    Health,
    Hello,
    ResetCause,
    Signal,
    Start,
    TimeRequest,
    wire_fields,
)

_CLOCK_WAIT_NS = NS_PER_S // 2  # how long samples are held back for the first answers of the clock
_CLOCK_ANSWERS = 6  # the first alone may have come late, by as much as a busy host was held up
_HELLO_EVERY_NS = NS_PER_S // 2
_START_AFTER_NS = 2 * NS_PER_S
_MOST_REQUESTS = 16

Send = Callable[[bytes], bool]
Timed = ImuBlock | MagSample | FilterSeen | HealthSeen  # logged at the time of its measurement


class NodeSession:
    """Turns a node's frames into log records, and keeps its clock.

    Samples are held back for up to half a second after a start until the node has answered some clock
    requests, so that the first of them do not carry times that must be taken back.
    """

    def __init__(
        self,
        name: str,
        link: str,
        node_id: int,
        send: Send,
        sink: Sink,
        now_ns: Callable[[], int],
        *,
        datagrams: bool,
        clock_period: float,
        order: ArrivalOrder,
    ) -> None:
        self.name = name
        self.link = link
        self.node_id = node_id
        self.decoder = RunDecoder(name, datagrams=datagrams)
        self.clock = ClockSync()
        self.health: Health | None = None
        self.signal: Signal | None = None
        """Of a node behind a receiver: how that hears it."""
        self.heard: list[Signal] = []
        """Of a receiver: what it has said of nodes since somebody took it from here."""
        self.filter: FilterSeen | None = None
        self.newest: ImuBlock | None = None
        self.gaps: dict[str, int] = {}  # cause -> how many
        self.notices: list[Event] = []  # for the user, taken away by who shows them
        self.last_frame_ns = 0
        self.span_ns: list[int] = []  # first and newest published time
        self.power_on_ns: int | None = None
        self._order = order
        self._boot: Hello | None = None  # of a start of which no sample has been published
        self._boot_id: int | None = None
        self._start: Event | None = None
        self._send = send
        self._sink = sink
        self._now_ns = now_ns
        self._times = SteadyTimes(self.clock)
        self._mag_times = SteadyTimes(self.clock)
        self._filter_times = SteadyTimes(self.clock)
        self._battery_times = SteadyTimes(self.clock)
        self._supplies = Supplies()
        self._held: list[Timed] = []
        self._held_since = 0
        self._questions = Questions(node_id)
        self._requests: dict[tuple[int, int], str] = {}  # of a user, not answered yet
        self._exchanges = Exchanges(node_id, int(clock_period * NS_PER_S))
        self._next_hello = 0
        self._start_at: int | None = None
        self._muted = False
        self._recent = RateWindow()

    def frame(self, frame: Frame, t_ns: int, link: LinkCounts) -> Iterator[Published]:
        """An undamaged frame of this node."""
        self.last_frame_ns = t_ns
        if self._muted:
            self._muted = False
            self._exchanges.burst()
            if not self.decoder.wants_hello:
                self._ask(GetHello())  # it may be another start, or another board
        yield from self._take(self.decoder.frame(frame, t_ns, link))

    def many(self, some: NodeFrames, downs: int) -> None:
        """Frames that a log has kept go into another; downs: how often their link had been lost before."""
        deque(self._take(self.decoder.many(some, downs)), maxlen=0)

    def settle(self, now_ns: int) -> Iterator[Published]:
        """Lets go of what waited long enough for a report of the node."""
        yield from self._take(self.decoder.tick(now_ns))

    def asked(self, token: bytes, t_ns: int) -> None:
        """A question of the clock exchange was sent at t_ns."""
        self._exchanges.asked(token, t_ns)

    def tick(self, now_ns: int) -> Iterator[Published]:
        """Asks what is due, and lets go of samples that waited long enough for the clock."""
        yield from self._take(self.decoder.tick(now_ns))
        yield from self._release_late(now_ns)
        if self.decoder.refusal is not None or self._muted:
            return
        if self.decoder.wants_hello:
            if now_ns >= self._next_hello:
                self._next_hello = now_ns + _HELLO_EVERY_NS
                self._ask(GetHello())
            return
        if self._start_at is not None and now_ns >= self._start_at:
            self._start_at = None
            self._ask(Start())  # somebody has told it to stop
        if self._exchanges.due(now_ns):
            self._ask_time()

    def _ask_time(self) -> None:
        """One question of the clock exchange; its token names the time at which it was sent."""
        token, now_ns = self._exchanges.token(), self._now_ns()
        self.asked(token, now_ns)
        self._sink.write_clock_request(self.link, now_ns, token)
        self._ask(TimeRequest(token))

    def request(self, message: Message, words: str) -> None:
        """Asks for a user what `words` say; that it was asked and what came of it are events."""
        seq, data = self._questions.wire(message)
        if not self._send(data):
            self._tell("request", f"{words}: not asked, the link is down")
            return
        while len(self._requests) >= _MOST_REQUESTS:
            self._requests.pop(next(iter(self._requests)))
        self._requests[message.type_id, seq] = words
        self._tell("request", f"{words}: asked")

    def _tell(self, kind: str, text: str) -> None:
        event = Event(self._now_ns(), kind, self.name, f"{self.name}: {text}", {"node": self.name})
        self._sink.write_event(event)

    def resumed(self, begin_ns: int, end_ns: int) -> None:
        """The computer stood still between these host times: the offset of its clock may be another."""
        self.decoder.resumed(begin_ns, end_ns)
        self._exchanges.forget()
        self._exchanges.burst()

    def mute(self) -> None:
        """Asks nothing more until the node has spoken: the link is new.

        A node that is booting must not be sent anything, and a device that is no node even less.
        """
        self._muted = True

    def tell_again(self, now_ns: int) -> None:
        """For a log that has just begun: what is known of the node, and what its raw frames are read with."""
        if self._start is not None:
            self._sink.write_event(self._start, now_ns)
        if self.decoder.refusal is None and not self._muted:
            self._ask(GetHello())
            self._exchanges.burst()

    def close(self, now_ns: int) -> Iterator[Published]:
        """Writes what was held back, and the node's last report."""
        yield from self._take(self.decoder.close())
        yield from self._release()
        if self.health is not None:
            self._sink.write_event(last_report(self.name, self.health, now_ns))
        if self.clock.source != "none":
            self._sink.write_event(clock_found(self.name, self.clock.estimate(), now_ns))

    def rate(self, now_ns: int) -> float:
        """Samples a second over the last two seconds, Hz."""
        return self._recent.rate(now_ns)

    def mean_rate(self) -> float | None:
        """Samples a second over the whole recording by their own times, lost ones counted; Hz."""
        counts = self.decoder.counts
        if not self.span_ns or self.span_ns[1] <= self.span_ns[0]:
            return None
        return (counts.samples + counts.samples_lost - 1) / ((self.span_ns[1] - self.span_ns[0]) / NS_PER_S)

    def _ask(self, message: Message) -> None:
        self._send(self._questions.wire(message)[1])

    def _take(self, outputs: Iterable[Output]) -> Iterator[Published]:
        for output in outputs:
            match output:
                case Event():
                    if output.kind == "conflict":
                        self.notices.append(output)
                    self._sink.write_event(self._gap(output) if output.kind == "gap" else output)
                case HelloSeen():
                    if output.hello.boot_id != self._boot_id:
                        self._boot, self._boot_id = output.hello, output.hello.boot_id
                    if output.restarted:
                        yield from self._release()
                        self.clock.reset()
                        self._exchanges.forget()
                        self._held_since = 0
                    self._exchanges.burst()
                    self._start_at = output.received_ns + _START_AFTER_NS
                    self._sink.add_metadata(f"node.{self.name}", hello_metadata(output.hello))
                case ImuBlock():
                    yield from self._block(output)
                case ImuRun():
                    yield from self._run(output)
                case GapsSeen():
                    for event in output.events():
                        self._sink.write_event(self._gap(event))
                case MagSample():
                    yield from self._hold(output)
                case FilterSeen():
                    self.filter = output
                    yield from self._hold(output)
                case TimeReplySeen():
                    yield from self._answered(output)
                case HealthSeen():
                    self.health = output.health
                    if output.health.battery_mv:
                        yield from self._hold(output)
                case AnswerSeen():
                    words = self._requests.pop((output.request, output.request_seq), None)
                    if words is not None:
                        self._tell("answer", f"{words}: {_answer_words(output.reason)}")
                case SignalSeen():
                    self._signal(output)
                case Refused():
                    data = {"node": self.name, "link": self.link, "host_fingerprint": f"{FINGERPRINT:08x}"}
                    mismatch = Event(output.received_ns, "mismatch", self.name, output.text, data)
                    self.notices.append(mismatch)
                    self._sink.write_event(mismatch)
                case _:
                    assert_never(output)

    def _block(self, block: ImuBlock) -> Iterator[Published]:
        self._start_at = None
        self.clock.arrival(int(block.device_ns[-1]) // 1000, block.received_ns)
        yield from self._hold(block)

    def _run(self, run: ImuRun) -> Iterator[Published]:
        """The blocks of a run: into the log in one go where their clock is known and nothing waits."""
        if not self._clock_known or self._held or self._boot is not None:
            for block in run.blocks():
                yield from self._block(block)
            return
        t_ns = self._times.apply(run.device_ns)
        log_ns = self._order.stamps(run.received_ns)
        counts = np.diff(run.first, append=len(t_ns))
        self._sink.write_imu(self.name, t_ns, np.repeat(log_ns, counts), run.gyro, run.accel)
        self._sink.write_temperature(self.name, t_ns[run.first], log_ns, run.temperature)
        self.span_ns = [self.span_ns[0] if self.span_ns else int(t_ns[0]), int(t_ns[-1])]

    def radio(self, signal: Signal) -> Iterator[Published]:
        """What a receiver on the same link says of this node."""
        self.signal = signal
        yield from self._take(self.decoder.radio(signal.frames_lost))

    def _signal(self, seen: SignalSeen) -> None:
        """This is a receiver: what it has heard of a node goes into the log, and to `heard`."""
        signal, t_ns = seen.signal, seen.received_ns
        counters = {item.name: [float(getattr(signal, item.name))] for item in wire_fields(Signal)[2:]}
        self._sink.write_columns(f"radio/{node_name(signal.of_node)}", [t_ns], t_ns, counters)
        self.heard.append(signal)

    def _gap(self, event: Event) -> Event:
        """Counts a gap, and puts its start on the time of measurement, where the samples stand."""
        cause = str(event.data["cause"])
        self.gaps[cause] = self.gaps.get(cause, 0) + 1
        between = event.data["device_ns"]
        if between is None or self.clock.source == "none":
            return event
        return replace(event, t_ns=int(self.clock.host_ns(np.array(between[:1], np.int64))[0]))

    def _answered(self, reply: TimeReplySeen) -> Iterator[Published]:
        """Takes one exchange into the clock; an answer to nobody's question is left alone."""
        sent_ns = self._exchanges.answered(reply.token)
        if sent_ns is None:
            return
        yield from self._release_late(reply.arrived_ns)
        resets = self.clock.resets
        self.clock.exchange(sent_ns, reply.received_us, reply.sent_us, reply.arrived_ns)
        if self.clock.resets != resets:
            text = f"{self.name}: the node's clock and the computer's no longer agree; offset estimated again"
            self._sink.write_event(Event(reply.arrived_ns, "clock", self.name, text, {"node": self.name}))
        if self._clock_known and self._held:
            yield from self._release()

    @property
    def _clock_known(self) -> bool:
        return self.clock.exchanges >= _CLOCK_ANSWERS

    def _late(self, now_ns: int) -> bool:
        return bool(self._held_since) and now_ns - self._held_since > _CLOCK_WAIT_NS

    def _release_late(self, now_ns: int) -> Iterator[Published]:
        if self._held and self._late(now_ns):
            yield from self._release()

    def _stamp_without_samples(self, item: MagSample | FilterSeen | HealthSeen) -> None:
        """Let a report set the clock of a node that has sent no sample and answered no question.

        The node's own time alone, which starts near zero, would stamp the report in 1970 or before.
        """
        if self.clock.source == "none":
            self.clock.arrival(item.device_ns // 1000, item.received_ns)

    def _hold(self, item: Timed) -> Iterator[Published]:
        if self._clock_known or self._late(item.received_ns):
            yield from self._release()
            yield from self._publish(item)
            return
        if not self._held_since:
            self._held_since = item.received_ns
        self._held.append(item)

    def _release(self) -> Iterator[Published]:
        held, self._held = self._held, []
        for item in held:
            yield from self._publish(item)

    def _publish(self, item: Timed) -> Iterator[Published]:
        if not isinstance(item, ImuBlock):
            self._stamp_without_samples(item)
        if isinstance(item, MagSample):
            t_ns = self._mag_times.apply(np.array([item.device_ns], np.int64))
            self._sink.write_magnetic_field(self.name, t_ns, item.received_ns, [item.field])
            return
        if isinstance(item, FilterSeen):
            t_ns = self._filter_times.apply(np.array([item.device_ns], np.int64))
            self._sink.write_bias_filter(self.name, t_ns, item.received_ns, filter_columns(item))
            return
        if isinstance(item, HealthSeen):
            t_ns = self._battery_times.apply(np.array([item.device_ns], np.int64))
            volts, charge = supply(item.health)
            self._sink.write_battery(self.name, t_ns, item.received_ns, volts, charge)
            self._supplies.tell(int(t_ns[0]), volts)
            return
        t_ns = self._times.apply(item.device_ns)
        if self._boot is not None:
            self._started(self._boot, int(t_ns[0]))
            self._boot = None
        log_ns = self._order.stamp(item.received_ns)
        self._sink.write_imu(self.name, t_ns, log_ns, item.gyro, item.accel)
        self._sink.write_temperature(self.name, t_ns[:1], log_ns, item.temperature)
        self.span_ns = [self.span_ns[0] if self.span_ns else int(t_ns[0]), int(t_ns[-1])]
        self._recent.add(item.received_ns, len(t_ns))
        self.newest = item
        yield Published(self.name, t_ns, item, self.power_on_ns, self._supplies.at(int(t_ns[0])))

    def _started(self, hello: Hello, t_ns: int) -> None:
        """Notes when the node was switched on; a restart without loss of power leaves the chip warm."""
        if self.power_on_ns is None or hello.reset_cause in (ResetCause.POWER_ON, ResetCause.BROWN_OUT):
            self.power_on_ns = int(self.clock.host_ns(np.zeros(1, np.int64))[0])
        self._start = switched_on(self.name, hello.boot_id, self.power_on_ns, t_ns)
        self._sink.write_event(self._start)


def _answer_words(reason: int | None) -> str:
    return "done" if reason is None else f"refused: {reason_words(reason)}"
