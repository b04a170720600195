"""The recorder's state of one node: decoder, clock, requests and log records."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import assert_never

import numpy as np

from hubodo.ingest.node.clock import ClockSync
from hubodo.ingest.node.clock_exchanges import ClockExchanges
from hubodo.ingest.node.decoder import DecoderOutput
from hubodo.ingest.node.gaps import GapGroup, LinkCounts
from hubodo.ingest.node.health import is_asleep
from hubodo.ingest.node.identity import hello_metadata
from hubodo.ingest.node.imu_noise import sample_noise
from hubodo.ingest.node.life_events import final_clock_event, final_health_event
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.node.node_frames import NodeFrames
from hubodo.ingest.node.outputs import (
    AnswerReceived,
    BiasFilterReport,
    HealthReceived,
    HelloReceived,
    HighGBlock,
    MagSample,
    SignalReceived,
    TimeReplyReceived,
    WireMismatchReport,
)
from hubodo.ingest.node.request_encoder import RequestEncoder
from hubodo.ingest.node.run_decoder import RunDecoder
from hubodo.ingest.node.sample_publisher import SamplePublisher
from hubodo.ingest.node.user_requests import OnOutcome, SendBytes, UserRequests, ignore_outcome
from hubodo.log.records import (
    ClockRequest,
    Columns,
    EventRecord,
    ImuBlock,
    ImuNoise,
    ImuRun,
    Metadata,
    NodeSamples,
    Sink,
)
from hubodo.log.topics import NODE_RECORD_PREFIX
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire import FINGERPRINT, Frame, Message, node_name
from hubowire.messages import (
    Board,
    GetHello,
    Health,
    Signal,
    Start,
    TimeRequest,
    wire_fields,
)

_HELLO_INTERVAL_NS = NS_PER_S // 2
_START_DELAY_NS = 2 * NS_PER_S
_MIN_DROPPED_BY_RADIO = 3
"""Frames per report of a node that are no longer a moment's disturbance."""
_CLOCK_CHANGES_ASLEEP = (Board.ESP32, Board.ESP32_S3, Board.ESP32_C3)
"""Boards whose time is that of an RC oscillator during a sleep; samples wait for the clock after it."""


class NodeSession:
    """One node: its frames are decoded to log records, and its clock is synchronised."""

    def __init__(
        self,
        name: str,
        link: str,
        node_id: int,
        send: SendBytes,
        sink: Sink,
        now_ns: Callable[[], int],
        *,
        datagrams: bool,
        clock_period: float,
        order: LogTimeSequence,
    ) -> None:
        self.name = name
        self.link = link
        self.node_id = node_id
        self.decoder = RunDecoder(name, datagrams=datagrams)
        self.clock = ClockSync()
        self.health: Health | None = None
        self.signal: Signal | None = None
        """For a node behind a radio receiver: the receiver's newest report about it."""
        self.received_signals: list[Signal] = []
        """For a radio receiver: its reports about nodes that the recorder has not forwarded yet."""
        self.filter_report: BiasFilterReport | None = None
        self.gaps: dict[str, int] = {}  # number by cause
        self.last_frame_ns = 0
        self.samples = SamplePublisher(name, self.clock, sink, order)
        self.notices = self.samples.notices  # for the user; removed by the recorder once shown
        self._boot_id: int | None = None
        self._send = send
        self._sink = sink
        self._now_ns = now_ns
        self._request_encoder = RequestEncoder(node_id)
        self._user_requests = UserRequests(name, self._request_encoder, send, sink, now_ns)
        self._exchanges = ClockExchanges(node_id, int(clock_period * NS_PER_S))
        self._next_hello_ns = 0
        self._start_request_ns: int | None = None
        self._is_muted = False
        self._clock_changes_asleep = False
        self._channel_reported = False

    def handle_frame(self, frame: Frame, t_ns: int, link_counts: LinkCounts) -> Iterator[NodeSamples]:
        """Handle a valid frame of this node and yield the samples it completes."""
        self.last_frame_ns = t_ns
        if self._is_muted:
            self._is_muted = False
            self._exchanges.start_burst()
            if not self.decoder.wants_hello:
                self._send_message(GetHello())  # the sender may have restarted, or be another board
        yield from self._handle_outputs(self.decoder.decode_frame(frame, t_ns, link_counts))

    def handle_frames(self, frames: NodeFrames, disconnections: int) -> None:
        """Handle many frames of a log; disconnections: number of losses of their link before."""
        deque(self._handle_outputs(self.decoder.decode_many(frames, disconnections)), maxlen=0)

    def resolve_gaps(self, now_ns: int) -> Iterator[NodeSamples]:
        """Resolve gaps whose health report is overdue."""
        yield from self._handle_outputs(self.decoder.tick(now_ns))

    def add_clock_request(self, token: bytes, t_ns: int) -> None:
        """Note that a clock request was sent at `t_ns`."""
        self._exchanges.add_request(token, t_ns)

    def tick(self, now_ns: int) -> Iterator[NodeSamples]:
        """Send due requests and yield the samples that were held long enough for the clock."""
        yield from self._handle_outputs(self.decoder.tick(now_ns))
        yield from self.samples.release_expired(now_ns)
        if self.decoder.mismatch_text is not None or self._is_muted:
            return
        if self.decoder.wants_hello:
            if now_ns >= self._next_hello_ns:
                self._next_hello_ns = now_ns + _HELLO_INTERVAL_NS
                self._send_message(GetHello())
            return
        if self._start_request_ns is not None and now_ns >= self._start_request_ns:
            self._start_request_ns = None
            self._send_message(Start())  # another host has stopped it
        if self._exchanges.is_due(now_ns):
            self._send_time_request()

    def _send_time_request(self) -> None:
        """Send a clock request; its token identifies the time at which it was sent."""
        token, now_ns = self._exchanges.next_token(), self._now_ns()
        self.add_clock_request(token, now_ns)
        self._sink.write_record(ClockRequest(self.link, now_ns, token))
        self._send_message(TimeRequest(token))

    def request(self, message: Message, description: str, on_outcome: OnOutcome = ignore_outcome) -> None:
        """Send a request of a user; the request and its answer become events with this description."""
        self._user_requests.send(message, description, on_outcome)

    def note_host_suspension(self, start_ns: int, end_ns: int) -> None:
        """Note a suspension of the host, after which the clock offset may have changed."""
        self.decoder.note_host_suspension(start_ns, end_ns)
        self._exchanges.clear()
        self._exchanges.start_burst()

    def mute(self) -> None:
        """Send nothing until the next frame: a new link may lead to a booting node or to another device."""
        self._is_muted = True

    def repeat_state(self, now_ns: int) -> None:
        """Write the start event into a new log and request the Hello, which decoding it requires."""
        if self.samples.start_event is not None:
            self._sink.write_record(EventRecord(self.samples.start_event, now_ns))
        if self.decoder.mismatch_text is None and not self._is_muted:
            self._send_message(GetHello())
            self._exchanges.start_burst()

    def close(self, now_ns: int) -> Iterator[NodeSamples]:
        """Write held samples and the final events of the node."""
        yield from self._handle_outputs(self.decoder.close())
        yield from self.samples.release()
        if self.health is not None:
            self._sink.write_record(EventRecord(final_health_event(self.name, self.health, now_ns)))
        if self.clock.source != "none":
            self._sink.write_record(EventRecord(final_clock_event(self.name, self.clock.estimate(), now_ns)))

    def mean_rate(self) -> float | None:
        """Return the mean sample rate by sample times, lost samples included, Hz; None before two samples."""
        return self.samples.mean_rate(self.decoder.counts.samples + self.decoder.counts.samples_lost)

    def _send_message(self, message: Message) -> None:
        self._send(self._request_encoder.encode_request(message)[1])

    def _handle_outputs(self, outputs: Iterable[DecoderOutput]) -> Iterator[NodeSamples]:
        for output in outputs:
            match output:
                case Event():
                    if output.kind == "conflict":
                        self.notices.append(output)
                    self._sink.write_record(
                        EventRecord(self._count_gap(output) if output.kind == "gap" else output)
                    )
                case HelloReceived():
                    if output.hello.boot_id != self._boot_id:
                        self.samples.start_boot(output.hello)
                        self._boot_id = output.hello.boot_id
                    if output.restarted:
                        yield from self.samples.restart()
                        self.clock.reset()
                        self._exchanges.clear()
                    self._exchanges.start_burst()
                    self._start_request_ns = output.received_ns + _START_DELAY_NS
                    self._clock_changes_asleep = output.hello.board in _CLOCK_CHANGES_ASLEEP
                    self._sink.write_record(
                        Metadata(NODE_RECORD_PREFIX + self.name, hello_metadata(output.hello))
                    )
                    self._sink.write_record(ImuNoise(self.name, *sample_noise(output.hello)))
                case ImuBlock():
                    yield from self._handle_block(output)
                case ImuRun():
                    yield from self._log_run(output)
                case GapGroup():
                    for event in output.to_events():
                        self._sink.write_record(EventRecord(self._count_gap(event)))
                case MagSample() | HighGBlock():
                    yield from self.samples.add(output)
                case BiasFilterReport():
                    self.filter_report = output
                    yield from self.samples.add(output)
                case TimeReplyReceived():
                    yield from self._handle_time_reply(output)
                case HealthReceived():
                    self._report_full_channel(output)
                    self.health = output.health
                    if self._clock_changes_asleep and is_asleep(output.health):
                        yield from self.samples.restart()
                        self.clock.reset()
                        self._exchanges.clear()
                    if output.health.battery_mv:
                        yield from self.samples.add(output)
                case AnswerReceived():
                    self._user_requests.handle_answer(output)
                case SignalReceived():
                    self._log_signal(output.signal, output.received_ns)
                case WireMismatchReport():
                    data = {"node": self.name, "link": self.link, "host_fingerprint": f"{FINGERPRINT:08x}"}
                    mismatch = Event(output.received_ns, "mismatch", self.name, output.text, data)
                    self.notices.append(mismatch)
                    self._sink.write_record(EventRecord(mismatch))
                case _:
                    assert_never(output)

    def _handle_block(self, block: ImuBlock) -> Iterator[NodeSamples]:
        self._start_request_ns = None
        self.clock.add_arrival(int(block.device_ns[-1]) // 1000, block.received_ns)
        yield from self.samples.add(block)

    def _log_run(self, run: ImuRun) -> Iterator[NodeSamples]:
        """Write a run to the log at once if the clock is synchronised and nothing is held."""
        if not self.samples.add_run(run):
            for block in run.split():
                yield from self._handle_block(block)

    def update_signal(self, signal: Signal) -> Iterator[NodeSamples]:
        """Update with the report of a radio receiver on the same link about this node."""
        self.signal = signal
        yield from self._handle_outputs(self.decoder.update_radio_losses(signal.frames_lost))

    def _log_signal(self, signal: Signal, t_ns: int) -> None:
        counters = {item.name: [float(getattr(signal, item.name))] for item in wire_fields(Signal)[2:]}
        self._sink.write_record(Columns(f"radio/{node_name(signal.of_node)}", [t_ns], t_ns, counters))
        self.received_signals.append(signal)

    def _report_full_channel(self, report: HealthReceived) -> None:
        """Report, once, a node whose frames its radio cannot send in time."""
        if self.signal is None or self.health is None or self._channel_reported:
            return
        dropped = report.health.frames_dropped - self.health.frames_dropped
        if dropped < _MIN_DROPPED_BY_RADIO:
            return
        self._channel_reported = True
        text = (
            f"{self.name}: its radio channel is full or disturbed, {dropped} frames were dropped; "
            "choose another channel, a lower rate_hz, or a second receiver"
        )
        event = Event(report.received_ns, "warning", self.name, text, {"node": self.name, "dropped": dropped})
        self.notices.append(event)
        self._sink.write_record(EventRecord(event))

    def _count_gap(self, event: Event) -> Event:
        """Count a gap and return its event with the measurement time of the last sample before it."""
        cause = str(event.data["cause"])
        self.gaps[cause] = self.gaps.get(cause, 0) + 1
        between = event.data["device_ns"]
        if between is None or self.clock.source == "none":
            return event
        return replace(event, t_ns=int(self.clock.to_host_ns(np.array(between[:1], np.int64))[0]))

    def _handle_time_reply(self, reply: TimeReplyReceived) -> Iterator[NodeSamples]:
        """Update the clock with one exchange; a reply without a matching request is ignored."""
        sent_ns = self._exchanges.match_reply(reply.token)
        if sent_ns is None:
            return
        yield from self.samples.release_expired(reply.arrived_ns)
        resets = self.clock.resets
        self.clock.add_exchange(sent_ns, reply.received_us, reply.sent_us, reply.arrived_ns)
        if self.clock.resets != resets:
            text = f"{self.name}: the node's clock and the computer's no longer agree; offset estimated again"
            event = Event(reply.arrived_ns, "clock", self.name, text, {"node": self.name})
            self._sink.write_record(EventRecord(event))
        if self.samples.clock_is_known:
            yield from self.samples.release()
