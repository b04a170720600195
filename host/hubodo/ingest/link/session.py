"""The recorder's state of one link: raw logging, routing of frames to nodes, damage and foreign data."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator

from hubodo.ingest.link.connection import Connection
from hubodo.ingest.link.foreign_bytes import describe_foreign_bytes, is_recognised
from hubodo.ingest.link.link import Chunk, LinkLost, LinkUp, RefusedDatagrams
from hubodo.ingest.link.throttle import EventThrottle
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.senders import MAX_NODES, MAX_SENDERS, Route, SenderTable
from hubodo.log.records import EventRecord, RawFrame, Sink
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire import Damage, FrameDecoder

DAMAGED_SUFFIX = "/damaged"
"""Suffix of a link's topic in the log for pieces between delimiters that are not valid frames."""

_FOREIGN_TIMEOUT_NS = 3 * NS_PER_S
_SILENCE_TIMEOUT_NS = 5 * NS_PER_S
_DAMAGE_REPORT_INTERVAL_NS = 10 * NS_PER_S
_FOREIGN_SAMPLE_BYTES = 512
_MAX_DAMAGED_BYTES_PER_S = 200_000
_MAX_SENDER_TOPICS = 15
"""Number of senders on a datagram port with a log topic each; later ones share one until identified."""
_DAMAGE_CAUSES = ("crc", "cobs", "short", "oversize")


class LinkSession:
    """Counters, frame decoders and log topics of one link, kept across its interruptions.

    In each connection, the piece before the first delimiter and the one after the last are parts of frames
    that were cut, not damaged: they are logged with the damaged frames but counted separately. At most 200 kB
    of damaged frames are logged per second, so that a port full of noise cannot fill the disk.
    """

    def __init__(self, label: str, sink: Sink) -> None:
        self.label = label
        self.connection = Connection(label, sink)
        self.datagrams = False
        self.frames = 0
        self.bytes = 0
        self.frames_cut = 0
        self.unlogged_bytes = 0
        """Bytes of damaged frames beyond the limit of what is logged per second."""
        self.datagrams_refused = 0
        """Number of datagrams that no key authenticated."""
        self.foreign: str | None = None
        self.damage = dict.fromkeys(_DAMAGE_CAUSES, 0)
        self._sink = sink
        self.senders = SenderTable(datagrams=False)
        self._decoders: OrderedDict[str, FrameDecoder] = OrderedDict()
        self._sender_topics: dict[str, int] = {}
        self._board_topics: dict[tuple[int, int], int] = {}
        self._awaiting_delimiter: set[str] = set()  # senders from which no delimiter was received yet
        self._foreign_bytes = bytearray()
        self._foreign_count = 0
        self._foreign_since_ns: int | None = None
        self._damaged_budget, self._budget_since_ns = _MAX_DAMAGED_BYTES_PER_S, 0
        self._last_received_ns: int | None = None
        self._damage_reported = 0
        self._next_damage_report_ns = 0
        self._silence_reported = False
        self._refusal_throttle = EventThrottle()
        self._refusals_reported = 0

    @property
    def counts(self) -> LinkCounts:
        """Counters that explain gaps: damaged frames and disconnections."""
        return LinkCounts(sum(self.damage.values()), self.connection.disconnections)

    @property
    def endpoint(self) -> str | None:
        """Name of the open device or address; None while the link is down."""
        return self.connection.endpoint

    def handle_up(self, report: LinkUp) -> None:
        """Handle the opening of the link."""
        if self.datagrams != report.datagrams:
            self.datagrams = report.datagrams
            self.senders = SenderTable(datagrams=report.datagrams)
        self.connection.handle_up(report)
        self._last_received_ns, self._silence_reported = report.t_ns, False

    def handle_lost(self, report: LinkLost) -> None:
        """Handle the loss of the link."""
        self.connection.handle_lost(report)
        self._foreign_since_ns = None  # nothing is received, so no foreign data either
        for sender in list(self._decoders):
            self._close_sender(sender, report.t_ns)

    def route_frames(self, chunk: Chunk) -> Iterator[Route]:
        """Log each piece between delimiters and yield the route of each valid frame."""
        self._last_received_ns = chunk.t_ns
        self.bytes += len(chunk.data)
        decoder, has_frame = self._decoder_of(chunk.sender), False
        for stuffed in decoder.split_frames(chunk.data):
            frame = decoder.decode_frame(stuffed)
            is_first_piece = chunk.sender in self._awaiting_delimiter
            self._awaiting_delimiter.discard(chunk.sender)
            if frame is None:
                self._log_damaged(self._topic_of(chunk.sender), chunk.t_ns, stuffed + b"\0")
                if is_first_piece:
                    self.frames_cut += 1
                    decoder.damage = Damage()
                self._count_damage(decoder)
                continue
            route = self.senders.route((frame, chunk.t_ns, self.counts), chunk.sender)
            self._sink.write_record(
                RawFrame(self._topic_of(chunk.sender, route), chunk.t_ns, stuffed + b"\0")
            )
            self.frames += 1
            has_frame = True
            self.connection.mark_valid()
            self._foreign_bytes.clear()
            self._foreign_count = 0
            self._foreign_since_ns = self.foreign = None
            yield route
        self._count_damage(decoder)
        if has_frame:
            return  # bytes after the last frame are the start of the next
        if self._foreign_since_ns is None:
            self._foreign_since_ns = chunk.t_ns
        self._foreign_count += len(chunk.data)
        if len(self._foreign_bytes) < _FOREIGN_SAMPLE_BYTES:
            self._foreign_bytes += chunk.data[: _FOREIGN_SAMPLE_BYTES - len(self._foreign_bytes)]

    def report_refused(self, report: RefusedDatagrams) -> Event:
        """Count and report datagrams that no key authenticated."""
        self.datagrams_refused += sum(report.refused.values())
        named = ", ".join(f"{count} {why}" for why, count in report.refused.items())
        text = f"{self.label}: datagrams refused: {named}"
        event = Event(report.t_ns, "refused", self.label, text, {"link": self.label, **report.refused})
        self._sink.write_record(EventRecord(event))
        return event

    def log_undecoded(self, chunk: Chunk) -> int:
        """Log the pieces without decoding them; return their number."""
        self.bytes += len(chunk.data)
        pieces = self._decoder_of(chunk.sender).split_frames(chunk.data)
        for stuffed in pieces:
            self._sink.write_record(RawFrame(self.label, chunk.t_ns, stuffed + b"\0"))
        return len(pieces)

    def tick(self, now_ns: int) -> Iterator[Event]:
        """Report foreign data, silence and damage; yield the events to show to the user."""
        if self.foreign is None and self._is_foreign(now_ns):
            self.foreign = describe_foreign_bytes(bytes(self._foreign_bytes), self._foreign_count)
            text = f"{self.label} ({self.endpoint}): bytes but no frame for 3 s: {self.foreign}"
            event = Event(now_ns, "foreign", self.label, text, {"link": self.label})
            self._sink.write_record(EventRecord(event))
            yield event
        is_silent = (
            self.endpoint is not None
            and self._last_received_ns is not None
            and now_ns - self._last_received_ns > _SILENCE_TIMEOUT_NS
        )
        if is_silent and not self._silence_reported:
            self._silence_reported = True
            text = f"{self.label} ({self.endpoint}): open, but no data for 5 s; is the node powered?"
            event = Event(now_ns, "silent", self.label, text, {"link": self.label})
            self._sink.write_record(EventRecord(event))
            yield event
        yield from self._report_refusals(now_ns)
        if now_ns >= self._next_damage_report_ns:
            self._next_damage_report_ns = now_ns + _DAMAGE_REPORT_INTERVAL_NS
            self._report_damage(now_ns)

    def _report_refusals(self, now_ns: int) -> Iterator[Event]:
        """Report refused frames of nodes beyond the limit, and senders dropped before identification."""
        senders = self.senders
        total = senders.frames_refused + senders.senders_evicted
        if total == self._refusals_reported or self._refusal_throttle.admit(now_ns) is None:
            return
        self._refusals_reported = total
        text = (
            f"{self.label}: {senders.frames_refused} frames of nodes beyond the first {MAX_NODES} refused in "
            f"total, {senders.senders_evicted} senders dropped before identification; give nodes keys "
            f"(hubodo flash --key-file), or move them to another port"
        )
        data = {
            "link": self.label,
            "frames_refused": senders.frames_refused,
            "senders_evicted": senders.senders_evicted,
        }
        event = Event(now_ns, "refused", self.label, text, data)
        self._sink.write_record(EventRecord(event))
        yield event

    def restart_timeouts(self, now_ns: int) -> None:
        """Restart the time limits for bytes and frames after a suspension of the host until `now_ns`."""
        if self._last_received_ns is not None:
            self._last_received_ns = now_ns
        if self._foreign_since_ns is not None:
            self._foreign_since_ns = now_ns

    def _is_foreign(self, now_ns: int) -> bool:
        """Return True if only bytes without a frame were received for 3 s; silence does not count."""
        if self._foreign_since_ns is None or self._last_received_ns is None:
            return False
        can_judge_now = not self.connection.is_valid or is_recognised(bytes(self._foreign_bytes))
        return (
            now_ns if can_judge_now else self._last_received_ns
        ) - self._foreign_since_ns > _FOREIGN_TIMEOUT_NS

    def _log_damaged(self, topic: str, t_ns: int, piece: bytes) -> None:
        if t_ns - self._budget_since_ns >= NS_PER_S:
            self._damaged_budget, self._budget_since_ns = _MAX_DAMAGED_BYTES_PER_S, t_ns
        if len(piece) > self._damaged_budget:
            self.unlogged_bytes += len(piece)
            return
        self._damaged_budget -= len(piece)
        self._sink.write_record(RawFrame(topic + DAMAGED_SUFFIX, t_ns, piece))

    def close(self, now_ns: int) -> None:
        """Log incomplete frames and report the remaining damage."""
        for sender in list(self._decoders):
            self._close_sender(sender, now_ns)
        self._report_damage(now_ns)

    def _topic_of(self, sender: str, route: Route | None = None) -> str:
        """Return the log topic for the pieces of a sender: the label, then label/2 for the second sender.

        Beyond `_MAX_SENDER_TOPICS` senders, a board gets a topic of its own once its Hello was received.
        """
        if not self.datagrams:
            return self.label
        number = self._sender_topics.get(sender)
        if number is None and len(self._sender_topics) < _MAX_SENDER_TOPICS:
            number = self._sender_topics[sender] = len(self._sender_topics) + 1
        if number is None and route is not None and route.board is not None:
            first = _MAX_SENDER_TOPICS + 2
            board = route.node_id, route.board
            number = self._board_topics.setdefault(board, first + len(self._board_topics))
        number = number or _MAX_SENDER_TOPICS + 1
        return self.label if number == 1 else f"{self.label}/{number}"

    def _decoder_of(self, sender: str) -> FrameDecoder:
        decoder = self._decoders.get(sender)
        if decoder is None:
            if len(self._decoders) >= MAX_SENDERS:
                self._decoders.popitem(last=False)
            decoder = self._decoders[sender] = FrameDecoder()
            if not self.datagrams:
                self._awaiting_delimiter.add(sender)
        elif self.datagrams:
            self._decoders.move_to_end(sender)
        return decoder

    def _count_damage(self, decoder: FrameDecoder) -> None:
        if decoder.damage.frames:
            for cause in _DAMAGE_CAUSES:
                self.damage[cause] += getattr(decoder.damage, cause)
            decoder.damage = Damage()

    def _close_sender(self, sender: str, t_ns: int) -> None:
        decoder = self._decoders.pop(sender)
        for incomplete in decoder.split_frames(b"\0"):
            self.frames_cut += 1
            self._sink.write_record(RawFrame(self._topic_of(sender) + DAMAGED_SUFFIX, t_ns, incomplete))
        self._awaiting_delimiter.discard(sender)

    def _report_damage(self, now_ns: int) -> None:
        total = sum(self.damage.values())
        if total == self._damage_reported:
            return
        new, self._damage_reported = total - self._damage_reported, total
        named = ", ".join(f"{cause} {count}" for cause, count in self.damage.items() if count)
        text = f"{self.label}: {new} damaged frames since the last report; in total: {named}"
        text += (
            f"; {self.unlogged_bytes} bytes of them were not logged (limit per second)"
            if self.unlogged_bytes
            else ""
        )
        data = {"link": self.label, "new": new, **self.damage, "bytes_not_logged": self.unlogged_bytes}
        self._sink.write_record(EventRecord(Event(now_ns, "damage", self.label, text, data)))
