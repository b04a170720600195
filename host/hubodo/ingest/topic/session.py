"""The recorder's state of one topic: times, damage and gaps of its messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from hubodo.ingest.link.connection import Connection
from hubodo.ingest.link.link import TopicMessage
from hubodo.ingest.node.gaps import LINK_DOWN, LOST_IN_TRANSIT, WireGap, gap_event
from hubodo.ingest.node.log_times import RateWindow
from hubodo.ingest.topic.handlers import TopicHandler, TopicItem
from hubodo.ingest.topic.port import TopicPort
from hubodo.ingest.topic.stamp_clock import StampClock
from hubodo.ingest.topic.stamp_loss import StampLoss
from hubodo.log.records import EventRecord, Sink
from hubodo.recording import Event
from hubodo.ros2.cdr import decode_message
from hubodo.units import NS_PER_S

UNDECODABLE, UNUSABLE, OUT_OF_ORDER, WRONG_STAMP = "undecodable", "unusable", "out of order", "wrong stamp"
_DAMAGE_REPORT_INTERVAL_NS = 10 * NS_PER_S


class TopicSession:
    """One topic: its messages become records of the log and items for odometry and map.

    Messages that cannot be used are skipped and counted by cause in `damage`. DDS does not report the loss of
    messages that are sent with best effort, so losses are inferred from gaps between stamps.
    """

    def __init__(self, port: TopicPort, handler: TopicHandler, sink: Sink) -> None:
        """Start without messages."""
        self.port = port
        self.handler = handler
        self.connection = Connection(port.label, sink)
        self.clock = StampClock()
        self.messages = self.bytes = self.samples = self.samples_lost = 0
        self.damage: Counter[str] = Counter()
        self.gaps: Counter[str] = Counter()
        """Number of gaps by cause."""
        self.last_message_ns = 0
        self.span_ns: list[int] = []
        """First and newest sample time."""
        self._sink = sink
        self._rate_window = RateWindow()
        self._loss = StampLoss()
        self._disconnections = self._clock_steps = 0
        self._damage_reported = self._next_damage_report_ns = 0

    def handle_message(self, message: TopicMessage) -> Iterable[TopicItem]:
        """Log a message and return its content for odometry and map."""
        self.messages += 1
        self.bytes += len(message.payload)
        self.last_message_ns = message.t_ns
        try:
            values = decode_message(message.message_type, message.payload)
        except ValueError:
            self.damage[UNDECODABLE] += 1
            return ()
        self.connection.mark_valid()
        stamp = values["header"]["stamp"]
        stamp_ns = stamp["sec"] * NS_PER_S + stamp["nanosec"]
        t_ns = self.clock.to_host_ns(stamp_ns, message.t_ns, message.wall_offset_ns)
        if t_ns is None:
            self.damage[WRONG_STAMP] += 1
            return ()
        if self.span_ns and t_ns <= self.span_ns[1]:
            self.damage[OUT_OF_ORDER] += 1
            return ()
        items = self.handler.handle(message.message_type, values, t_ns, message.t_ns)
        if items is None:
            self.damage[UNUSABLE] += 1
            return ()
        self._note_sample(t_ns, message.t_ns)
        return items

    def tick(self, now_ns: int) -> Iterator[Event]:
        """Report new damage to the log and the user, every ten seconds at most."""
        if now_ns >= self._next_damage_report_ns and self.damage.total() > self._damage_reported:
            self._next_damage_report_ns = now_ns + _DAMAGE_REPORT_INTERVAL_NS
            yield self._report_damage(now_ns)

    def close(self, now_ns: int) -> None:
        """Report the remaining damage to the log."""
        if self.damage.total() > self._damage_reported:
            self._report_damage(now_ns)

    def rate(self, now_ns: int) -> float:
        """Return the rate of messages over the last two seconds, Hz."""
        return self._rate_window.rate(now_ns)

    def mean_rate(self) -> float | None:
        """Return the mean rate by stamps, lost messages included, Hz; None before two messages."""
        if not self.span_ns or self.span_ns[1] <= self.span_ns[0]:
            return None
        return (self.samples + self.samples_lost - 1) / ((self.span_ns[1] - self.span_ns[0]) / NS_PER_S)

    def _note_sample(self, t_ns: int, received_ns: int) -> None:
        self.samples += 1
        self._rate_window.add(received_ns, 1)
        if not self.span_ns:
            self.span_ns = [t_ns, t_ns]
            return
        before_ns, self.span_ns[1] = self.span_ns[1], t_ns
        was_interrupted = (self._disconnections, self._clock_steps) != (
            self.connection.disconnections,
            self.clock.steps,
        )
        self._disconnections, self._clock_steps = self.connection.disconnections, self.clock.steps
        if was_interrupted:
            self._report_gap(before_ns, t_ns, None)
        elif lost := self._loss.add_interval(t_ns - before_ns):
            self._report_gap(before_ns, t_ns, lost)

    def _report_gap(self, start_ns: int, end_ns: int, lost: int | None) -> None:
        """Log a gap; lost: number of messages, None where it is unknown because the publisher was gone."""
        self.samples_lost += lost or 0
        cause = LINK_DOWN if lost is None else LOST_IN_TRANSIT
        self.gaps[cause] += 1
        gap = WireGap(self.handler.stream, start_ns, end_ns, lost or 0, lost)
        self._sink.write_record(EventRecord(gap_event(self.port.label, gap, cause)))

    def _report_damage(self, now_ns: int) -> Event:
        new, self._damage_reported = self.damage.total() - self._damage_reported, self.damage.total()
        causes = ", ".join(f"{cause} {count}" for cause, count in self.damage.items())
        text = f"{self.port.label}: {new} messages of {self.port.topic} not used; in total: {causes}"
        event = Event(
            now_ns, "damage", self.port.label, text, {"link": self.port.label, "new": new, **self.damage}
        )
        self._sink.write_record(EventRecord(event))
        return event
