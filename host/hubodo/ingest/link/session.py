"""One link as the recorder knows it: bytes logged raw, frames split by node, damage and strangers noticed."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator

from hubodo.ingest.link.connection import Connection
from hubodo.ingest.link.foreign import describe, recognised
from hubodo.ingest.link.link import Chunk, Intruders, LinkLost, LinkUp
from hubodo.ingest.link.throttle import EventThrottle
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.senders import MAX_NODES, MAX_SENDERS, Route, SenderTable
from hubodo.ingest.sink import Sink
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire import Damage, FrameDecoder

DAMAGED = "/damaged"
"""Behind a link's name in the log: pieces between delimiters that are no frame."""

_FOREIGN_NS = 3 * NS_PER_S
_SILENT_NS = 5 * NS_PER_S
_DAMAGE_EVERY_NS = 10 * NS_PER_S
_SAMPLE_BYTES = 512
_DAMAGED_BYTES_S = 200_000
_OWN_TOPICS = 15  # of the first senders of a datagram port; the others share one until they are identified
_CAUSES = ("crc", "cobs", "short", "oversize")


class LinkSession:
    """Counts and splits what comes over one link, across its interruptions.

    The piece before the first delimiter and the one after the last, of each connection, are halves of
    frames that were cut, not damaged: they are logged with the damaged ones but counted apart. Of damaged
    ones at most 200 kB a second are logged: a port that babbles must not fill the disk.
    """

    def __init__(self, label: str, sink: Sink) -> None:
        self.label = label
        self.connection = Connection(label, sink)
        self.datagrams = False
        self.frames = 0
        self.bytes = 0
        self.cut = 0
        self.unlogged = 0
        """Bytes of damaged frames that were too many to log."""
        self.refused = 0
        """Datagrams that no key proved."""
        self.foreign: str | None = None
        self.damage = dict.fromkeys(_CAUSES, 0)
        self._sink = sink
        self.senders = SenderTable(datagrams=False)
        self._decoders: OrderedDict[str, FrameDecoder] = OrderedDict()
        self._topics: dict[str, int] = {}
        self._board_topics: dict[tuple[int, int], int] = {}
        self._fresh: set[str] = set()  # senders of whom no delimiter has been seen yet
        self._strange = bytearray()
        self._strange_count = 0
        self._strange_since: int | None = None
        self._room, self._room_since = _DAMAGED_BYTES_S, 0
        self._heard_ns: int | None = None
        self._reported = 0
        self._next_report = 0
        self._silence_said = False
        self._refusals = EventThrottle()
        self._refusals_reported = 0

    @property
    def counts(self) -> LinkCounts:
        """What gaps are explained by."""
        return LinkCounts(sum(self.damage.values()), self.connection.downs)

    @property
    def where(self) -> str | None:
        """The device of today, None while the link is down."""
        return self.connection.where

    def up(self, news: LinkUp) -> None:
        """The link is open."""
        if self.datagrams != news.datagrams:
            self.datagrams = news.datagrams
            self.senders = SenderTable(datagrams=news.datagrams)
        self.connection.up(news)
        self._heard_ns, self._silence_said = news.t_ns, False

    def lost(self, news: LinkLost) -> None:
        """The link has gone."""
        self.connection.lost(news)
        self._strange_since = None  # nothing comes: nobody strange speaks
        for sender in list(self._decoders):
            self._end(sender, news.t_ns)

    def chunk(self, chunk: Chunk) -> Iterator[Route]:
        """Log each piece between delimiters and yield where it goes if it is a frame."""
        self._heard_ns = chunk.t_ns
        self.bytes += len(chunk.data)
        decoder, met = self._decoder(chunk.sender), False
        for stuffed in decoder.split(chunk.data):
            frame = decoder.decode(stuffed)
            fresh = chunk.sender in self._fresh
            self._fresh.discard(chunk.sender)
            if frame is None:
                self._keep_damaged(self._place(chunk.sender), chunk.t_ns, stuffed + b"\0")
                if fresh:
                    self.cut += 1
                    decoder.damage = Damage()
                self._count(decoder)
                continue
            route = self.senders.route((frame, chunk.t_ns, self.counts), chunk.sender)
            self._sink.write_raw_frame(self._place(chunk.sender, route), chunk.t_ns, stuffed + b"\0")
            self.frames += 1
            met = True
            self.connection.mark_valid()
            self._strange.clear()
            self._strange_count = 0
            self._strange_since = self.foreign = None
            yield route
        self._count(decoder)
        if met:
            return  # what came behind the last frame is the beginning of the next
        if self._strange_since is None:
            self._strange_since = chunk.t_ns
        self._strange_count += len(chunk.data)
        if len(self._strange) < _SAMPLE_BYTES:
            self._strange += chunk.data[: _SAMPLE_BYTES - len(self._strange)]

    def report_intruders(self, news: Intruders) -> Event:
        """Count and report datagrams that no key proved."""
        self.refused += sum(news.refused.values())
        named = ", ".join(f"{count} {why}" for why, count in news.refused.items())
        text = f"{self.label}: datagrams refused: {named}"
        event = Event(news.t_ns, "refused", self.label, text, {"link": self.label, **news.refused})
        self._sink.write_event(event)
        return event

    def keep(self, chunk: Chunk) -> int:
        """Logs the pieces without looking into them; how many there were."""
        self.bytes += len(chunk.data)
        pieces = self._decoder(chunk.sender).split(chunk.data)
        for stuffed in pieces:
            self._sink.write_raw_frame(self.label, chunk.t_ns, stuffed + b"\0")
        return len(pieces)

    def tick(self, now_ns: int) -> Iterator[Event]:
        """Yields what the user should see: a stranger on the line, or silence."""
        if self.foreign is None and self._sounds_strange(now_ns):
            self.foreign = describe(bytes(self._strange), self._strange_count)
            text = f"{self.label} ({self.where}): bytes but no frame for 3 s: {self.foreign}"
            event = Event(now_ns, "foreign", self.label, text, {"link": self.label})
            self._sink.write_event(event)
            yield event
        silent = (
            self.where is not None and self._heard_ns is not None and now_ns - self._heard_ns > _SILENT_NS
        )
        if silent and not self._silence_said:
            self._silence_said = True
            text = f"{self.label} ({self.where}): open, but nothing has come for 5 s; is the node powered?"
            event = Event(now_ns, "silent", self.label, text, {"link": self.label})
            self._sink.write_event(event)
            yield event
        yield from self._report_refusals(now_ns)
        if now_ns >= self._next_report:
            self._next_report = now_ns + _DAMAGE_EVERY_NS
            self._report(now_ns)

    def _report_refusals(self, now_ns: int) -> Iterator[Event]:
        """Report frames of nodes beyond the limit, and senders that were dropped unidentified."""
        senders = self.senders
        total = senders.refused + senders.evicted
        if total == self._refusals_reported or self._refusals.admit(now_ns) is None:
            return
        self._refusals_reported = total
        text = (
            f"{self.label}: in all {senders.refused} frames of nodes beyond the first {MAX_NODES} refused, "
            f"{senders.evicted} senders dropped that did not identify themselves; give nodes keys "
            f"(hubodo flash --key-file), or them another port"
        )
        data = {"link": self.label, "frames_refused": senders.refused, "senders_evicted": senders.evicted}
        event = Event(now_ns, "refused", self.label, text, data)
        self._sink.write_event(event)
        yield event

    def resumed(self, now_ns: int) -> None:
        """Begin the waiting for bytes and for a frame again: the computer stood still until now."""
        if self._heard_ns is not None:
            self._heard_ns = now_ns
        if self._strange_since is not None:
            self._strange_since = now_ns

    def _sounds_strange(self, now_ns: int) -> bool:
        """Whether only bytes that are no frame have come for a while; mere silence is not strange."""
        if self._strange_since is None or self._heard_ns is None:
            return False
        known = not self.connection.is_valid or recognised(bytes(self._strange))
        return (now_ns if known else self._heard_ns) - self._strange_since > _FOREIGN_NS

    def _keep_damaged(self, place: str, t_ns: int, piece: bytes) -> None:
        if t_ns - self._room_since >= NS_PER_S:
            self._room, self._room_since = _DAMAGED_BYTES_S, t_ns
        if len(piece) > self._room:
            self.unlogged += len(piece)
            return
        self._room -= len(piece)
        self._sink.write_raw_frame(place + DAMAGED, t_ns, piece)

    def close(self, now_ns: int) -> None:
        """Accounts for what is left."""
        for sender in list(self._decoders):
            self._end(sender, now_ns)
        self._report(now_ns)

    def _place(self, sender: str, route: Route | None = None) -> str:
        """Return where in the log the pieces of a sender go: those of the second beside those of the first.

        Where more have come than have places of their own, a board has one from its Hello on.
        """
        if not self.datagrams:
            return self.label
        number = self._topics.get(sender)
        if number is None and len(self._topics) < _OWN_TOPICS:
            number = self._topics[sender] = len(self._topics) + 1
        if number is None and route is not None and route.board is not None:
            first = _OWN_TOPICS + 2
            board = route.node_id, route.board
            number = self._board_topics.setdefault(board, first + len(self._board_topics))
        number = number or _OWN_TOPICS + 1
        return self.label if number == 1 else f"{self.label}/{number}"

    def _decoder(self, sender: str) -> FrameDecoder:
        decoder = self._decoders.get(sender)
        if decoder is None:
            if len(self._decoders) >= MAX_SENDERS:
                self._decoders.popitem(last=False)
            decoder = self._decoders[sender] = FrameDecoder()
            if not self.datagrams:
                self._fresh.add(sender)
        elif self.datagrams:
            self._decoders.move_to_end(sender)
        return decoder

    def _count(self, decoder: FrameDecoder) -> None:
        if decoder.damage.frames:
            for cause in _CAUSES:
                self.damage[cause] += getattr(decoder.damage, cause)
            decoder.damage = Damage()

    def _end(self, sender: str, t_ns: int) -> None:
        decoder = self._decoders.pop(sender)
        for rest in decoder.split(b"\0"):
            self.cut += 1
            self._sink.write_raw_frame(self._place(sender) + DAMAGED, t_ns, rest)
        self._fresh.discard(sender)

    def _report(self, now_ns: int) -> None:
        total = sum(self.damage.values())
        if total == self._reported:
            return
        new, self._reported = total - self._reported, total
        named = ", ".join(f"{cause} {count}" for cause, count in self.damage.items() if count)
        text = f"{self.label}: {new} damaged frames since the last report; in all: {named}"
        text += f"; {self.unlogged} bytes of them were too many to log" if self.unlogged else ""
        data = {"link": self.label, "new": new, **self.damage, "bytes_not_logged": self.unlogged}
        self._sink.write_event(Event(now_ns, "damage", self.label, text, data))
