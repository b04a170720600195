"""One link as the recorder knows it: bytes logged raw, frames split by node, damage and strangers noticed."""

from __future__ import annotations

from collections.abc import Iterator

from hubodo.ingest.link.foreign import describe, recognised
from hubodo.ingest.link.link import Chunk, LinkLost, LinkUp
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.sink import Sink
from hubodo.recording import Event
from hubowire import Damage, Frame, FrameDecoder

S = 1_000_000_000
DAMAGED = "/damaged"
"""Behind a link's name in the log: pieces between delimiters that are no frame."""

_FOREIGN_NS = 3 * S
_SILENT_NS = 5 * S
_DAMAGE_EVERY_NS = 10 * S
_SAMPLE_BYTES = 512
_DAMAGED_BYTES_S = 200_000
_MAX_SENDERS = 64
_MOST_PLACES = 16
_CAUSES = ("crc", "cobs", "short", "oversize")


class LinkSession:
    """Counts and splits what comes over one link, across its interruptions.

    The piece before the first delimiter and the one after the last, of each connection, are halves of
    frames that were cut, not damaged: they are logged with the damaged ones but counted apart. Of damaged
    ones at most 200 kB a second are logged: a port that babbles must not fill the disk.
    """

    def __init__(self, label: str, sink: Sink) -> None:
        self.label = label
        self.where: str | None = None
        self.datagrams = False
        self.frames = 0
        self.bytes = 0
        self.cut = 0
        self.unlogged = 0
        """Bytes of damaged frames that were too many to log."""
        self.downs = 0
        self.foreign: str | None = None
        self.missed = False
        self.damage = dict.fromkeys(_CAUSES, 0)
        self._sink = sink
        self._decoders: dict[str, FrameDecoder] = {}
        self._senders: dict[str, int] = {}
        self._fresh: set[str] = set()  # senders of whom no delimiter has been seen yet
        self._strange = bytearray()
        self._strange_count = 0
        self._strange_since: int | None = None
        self._met = False  # a frame has come since the link is open
        self._room, self._room_since = _DAMAGED_BYTES_S, 0
        self._heard_ns: int | None = None
        self._reported = 0
        self._next_report = 0
        self._silence_said = False

    @property
    def counts(self) -> LinkCounts:
        """What gaps are explained by."""
        return LinkCounts(sum(self.damage.values()), self.downs)

    def up(self, news: LinkUp) -> None:
        """The link is open."""
        self.where, self.datagrams = news.where, news.datagrams
        self._heard_ns, self._silence_said, self._met = news.t_ns, False, False
        text = f"{self.label}: connected at {news.where}"
        self._sink.event(
            Event(news.t_ns, "connected", self.label, text, {"link": self.label, "where": news.where})
        )

    def lost(self, news: LinkLost) -> None:
        """The link has gone."""
        was_open, self.where, self.missed = self.where is not None, None, True
        self._strange_since = None  # nothing comes: nobody strange speaks
        if was_open:
            self.downs += 1
        for sender in list(self._decoders):
            self._end(sender, news.t_ns)
        text = f"{self.label}: {'disconnected' if was_open else 'not there yet'}: {news.text}"
        self._sink.event(Event(news.t_ns, "disconnected", self.label, text, {"link": self.label}))

    def chunk(self, chunk: Chunk) -> Iterator[Frame]:
        """Logs each piece between delimiters, then yields it if it is a frame."""
        self._heard_ns = chunk.t_ns
        self.bytes += len(chunk.data)
        decoder, met = self._decoder(chunk.sender), False
        place = self._place(chunk.sender)
        for stuffed in decoder.split(chunk.data):
            frame = decoder.decode(stuffed)
            fresh = chunk.sender in self._fresh
            self._fresh.discard(chunk.sender)
            if frame is None:
                self._keep_damaged(place, chunk.t_ns, stuffed + b"\0")
                if fresh:
                    self.cut += 1
                    decoder.damage = Damage()
            else:
                self._sink.raw(place, chunk.t_ns, stuffed + b"\0")
                self.frames += 1
                met = self._met = True
                self._strange.clear()
                self._strange_count = 0
                self._strange_since = self.foreign = None
            self._count(decoder)
            if frame is not None:
                yield frame
        self._count(decoder)
        if met:
            return  # what came behind the last frame is the beginning of the next
        if self._strange_since is None:
            self._strange_since = chunk.t_ns
        self._strange_count += len(chunk.data)
        if len(self._strange) < _SAMPLE_BYTES:
            self._strange += chunk.data[: _SAMPLE_BYTES - len(self._strange)]

    def keep(self, chunk: Chunk) -> int:
        """Logs the pieces without looking into them; how many there were."""
        self.bytes += len(chunk.data)
        pieces = self._decoder(chunk.sender).split(chunk.data)
        for stuffed in pieces:
            self._sink.raw(self.label, chunk.t_ns, stuffed + b"\0")
        return len(pieces)

    def tick(self, now_ns: int) -> Iterator[Event]:
        """Yields what the user should see: a stranger on the line, or silence."""
        if self.foreign is None and self._sounds_strange(now_ns):
            self.foreign = describe(bytes(self._strange), self._strange_count)
            text = f"{self.label} ({self.where}): bytes but no frame for 3 s: {self.foreign}"
            event = Event(now_ns, "foreign", self.label, text, {"link": self.label})
            self._sink.event(event)
            yield event
        silent = (
            self.where is not None and self._heard_ns is not None and now_ns - self._heard_ns > _SILENT_NS
        )
        if silent and not self._silence_said:
            self._silence_said = True
            text = f"{self.label} ({self.where}): open, but nothing has come for 5 s; is the node powered?"
            event = Event(now_ns, "silent", self.label, text, {"link": self.label})
            self._sink.event(event)
            yield event
        if now_ns >= self._next_report:
            self._next_report = now_ns + _DAMAGE_EVERY_NS
            self._report(now_ns)

    def _sounds_strange(self, now_ns: int) -> bool:
        """Whether only bytes that are no frame have come for a while; mere silence is not strange."""
        if self._strange_since is None or self._heard_ns is None:
            return False
        known = not self._met or recognised(bytes(self._strange))
        return (now_ns if known else self._heard_ns) - self._strange_since > _FOREIGN_NS

    def _keep_damaged(self, place: str, t_ns: int, piece: bytes) -> None:
        if t_ns - self._room_since >= S:
            self._room, self._room_since = _DAMAGED_BYTES_S, t_ns
        if len(piece) > self._room:
            self.unlogged += len(piece)
            return
        self._room -= len(piece)
        self._sink.raw(place + DAMAGED, t_ns, piece)

    def close(self, now_ns: int) -> None:
        """Accounts for what is left."""
        for sender in list(self._decoders):
            self._end(sender, now_ns)
        self._report(now_ns)

    def _place(self, sender: str) -> str:
        """Where in the log the pieces of a sender go: those of the second one beside those of the first."""
        if not self.datagrams:
            return self.label
        number = self._senders.setdefault(sender, min(len(self._senders) + 1, _MOST_PLACES))
        return self.label if number == 1 else f"{self.label}/{number}"

    def _decoder(self, sender: str) -> FrameDecoder:
        decoder = self._decoders.get(sender)
        if decoder is None:
            if len(self._decoders) >= _MAX_SENDERS:
                self._decoders.pop(next(iter(self._decoders)))
            decoder = self._decoders[sender] = FrameDecoder()
            if not self.datagrams:
                self._fresh.add(sender)
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
            self._sink.raw(self._place(sender) + DAMAGED, t_ns, rest)
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
        self._sink.event(Event(now_ns, "damage", self.label, text, data))
