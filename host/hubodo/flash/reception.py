"""Reception from a port for a few seconds: frames, samples, clock replies, or a prompt."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass, field

from hubodo.ingest.link.open_link import LinkDown, Transport
from hubodo.ingest.link.serial_port import open_serial
from hubodo.ingest.node.boot import NodeCounts
from hubodo.ingest.node.decoder import NodeDecoder
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.outputs import HealthReceived, TimeReplyReceived
from hubodo.log.records import ImuBlock
from hubodo.units import NS_PER_S
from hubowire import FrameDecoder, Message, encode, encode_frame
from hubowire.framing import Frame
from hubowire.messages import ANY_NODE, GetHello, Health, Hello, TimeRequest

_PROMPTS = (b">>> ", b"raw REPL; CTRL-B to exit\r\n>")
_REQUEST_PERIOD_NS, _CLOCK_PERIOD_NS = NS_PER_S // 2, NS_PER_S // 20
_TAIL_BYTES = 4096


@dataclass
class Reception:
    """The data received from a port; all but `n_bytes`, `n_frames` and `tail` belong to the first node.

    Attributes
    ----------
    n_bytes
        Number of bytes.
    n_frames, n_damaged
        Number of valid and of damaged frames.
    has_prompt
        True if a MicroPython prompt answered.
    disconnection
        Reason if the port disconnected.
    node, hello, mismatch
        Id and identification of the node, or the reason why it cannot be decoded.
    blocks, reports, counts
        Samples, health messages and losses.
    exchanges
        Host time, node time and round trip of each clock reply, ns.
    tail
        The last bytes.
    """

    n_bytes: int = 0
    n_frames: int = 0
    n_damaged: int = 0
    has_prompt: bool = False
    disconnection: str = ""
    node: int | None = None
    hello: Hello | None = None
    mismatch: str | None = None
    blocks: list[ImuBlock] = field(default_factory=list)
    reports: list[Health] = field(default_factory=list)
    counts: NodeCounts = field(default_factory=NodeCounts)
    exchanges: list[tuple[int, int, int]] = field(default_factory=list)
    tail: bytes = b""


def listen(port: str, baud: int, seconds: float, *, briefly: bool = False) -> Reception:
    """Listen to a port, request identification and clock of a node, and wake a silent port.

    briefly: True to stop listening as soon as a node is received. Raises LinkError if the port is missing,
    busy or not permitted.
    """
    reception = Reception()
    link = open_serial(port, baud)
    try:
        with contextlib.suppress(LinkDown):
            _Listener(link, reception).run(seconds, briefly)
            return reception
        reception.disconnection = f"{port} disconnected while it was read"
        return reception
    finally:
        link.close()


class _Listener:
    def __init__(self, link: Transport, reception: Reception) -> None:
        self._link, self._reception = link, reception
        self._frames, self._node = FrameDecoder(), NodeDecoder("node")
        self._seq, self._sent_ns = 0, dict[bytes, int]()

    def run(self, seconds: float, briefly: bool) -> None:
        reception = self._reception
        start = time.monotonic_ns()
        requested_ns = clock_ns = start
        while (now := time.monotonic_ns()) < start + seconds * NS_PER_S:
            data, _ = self._link.read(0.01)
            arrived = time.monotonic_ns()
            if data:
                self._process(data, arrived)
            if (
                now - requested_ns > _REQUEST_PERIOD_NS
                and reception.hello is None
                and reception.mismatch is None
            ):
                requested_ns = now
                if reception.n_frames:
                    self._request(GetHello())
                elif not reception.n_bytes:
                    self._link.write(b"\r\x02", "")
            if reception.hello is not None and now - clock_ns > _CLOCK_PERIOD_NS:
                clock_ns = now
                token = self._seq.to_bytes(8, "little").replace(b"\x03", b"\x83")
                self._sent_ns[token] = time.monotonic_ns()
                self._request(TimeRequest(token))
            if (briefly and reception.n_frames) or (reception.has_prompt and not reception.n_frames):
                break
        for item in self._node.close():
            self._store(item)
        reception.counts, reception.mismatch = self._node.counts, self._node.mismatch_text

    def _process(self, data: bytes, now: int) -> None:
        reception = self._reception
        reception.n_bytes += len(data)
        reception.tail = (reception.tail + data)[-_TAIL_BYTES:]
        for frame in self._frames.feed(data):
            reception.n_frames += 1
            reception.node = frame.node if reception.node is None else reception.node
            if frame.node == reception.node:
                for item in self._node.decode_frame(frame, now, LinkCounts(self._damaged())):
                    self._store(item)
        reception.hello, reception.mismatch, reception.n_damaged = (
            self._node.hello,
            self._node.mismatch_text,
            self._damaged(),
        )
        reception.has_prompt = reception.tail.endswith(_PROMPTS)

    def _store(self, item: object) -> None:
        if isinstance(item, ImuBlock):
            self._reception.blocks.append(item)
        elif isinstance(item, HealthReceived):
            self._reception.reports.append(item.health)
        elif isinstance(item, TimeReplyReceived) and item.token in self._sent_ns:
            sent = self._sent_ns.pop(item.token)
            node_ns = (item.received_us + item.sent_us) * 500
            trip = item.arrived_ns - sent - (item.sent_us - item.received_us) * 1000
            self._reception.exchanges.append(((sent + item.arrived_ns) // 2, node_ns, trip))

    def _damaged(self) -> int:
        damage = self._frames.damage
        return damage.crc + damage.cobs + damage.short + damage.oversize

    def _request(self, message: Message) -> None:
        self._seq = (self._seq + 1) & 0xFFFF
        self._link.write(
            b"\0" + encode_frame(Frame(message.type_id, ANY_NODE, self._seq, encode(message))), ""
        )
