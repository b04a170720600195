"""What comes from a port in a few seconds: bytes, frames, samples, answers about the clock, or a prompt."""

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
_ASK_AFTER_NS, _CLOCK_EVERY_NS = NS_PER_S // 2, NS_PER_S // 20
_TAIL = 4096


@dataclass
class Heard:
    """What came; received: bytes. All but that, frames and tail is of the node that was heard first.

    exchanges: (host time, node time, round trip) of each answer about the clock, ns.
    """

    received: int = 0
    frames: int = 0
    damaged: int = 0
    prompt: bool = False
    gone: str = ""
    node: int | None = None
    hello: Hello | None = None
    refusal: str | None = None
    blocks: list[ImuBlock] = field(default_factory=list)
    reports: list[Health] = field(default_factory=list)
    counts: NodeCounts = field(default_factory=NodeCounts)
    exchanges: list[tuple[int, int, int]] = field(default_factory=list)
    tail: bytes = b""


def listen(port: str, baud: int, seconds: float, *, briefly: bool = False) -> Heard:
    """Listens, asks a node that speaks who it is and what its clock shows, and a silent port for a prompt.

    briefly: until a node is heard. Raises LinkError when the port is missing, busy or not allowed.
    """
    heard = Heard()
    link = open_serial(port, baud)
    try:
        with contextlib.suppress(LinkDown):
            _Listener(link, heard).run(seconds, briefly)
            return heard
        heard.gone = f"{port} went away while it was read"
        return heard
    finally:
        link.close()


class _Listener:
    def __init__(self, link: Transport, heard: Heard) -> None:
        self._link, self._heard = link, heard
        self._frames, self._node = FrameDecoder(), NodeDecoder("node")
        self._seq, self._sent_ns = 0, dict[bytes, int]()

    def run(self, seconds: float, briefly: bool) -> None:
        heard = self._heard
        begin = time.monotonic_ns()
        asked_ns = clock_ns = begin
        while (now := time.monotonic_ns()) < begin + seconds * NS_PER_S:
            data, _ = self._link.read(0.01)
            arrived = time.monotonic_ns()
            if data:
                self._take(data, arrived)
            if now - asked_ns > _ASK_AFTER_NS and heard.hello is None and heard.refusal is None:
                asked_ns = now
                if heard.frames:
                    self._ask(GetHello())
                elif not heard.received:
                    self._link.write(b"\r\x02", "")
            if heard.hello is not None and now - clock_ns > _CLOCK_EVERY_NS:
                clock_ns = now
                token = self._seq.to_bytes(8, "little").replace(b"\x03", b"\x83")
                self._sent_ns[token] = time.monotonic_ns()
                self._ask(TimeRequest(token))
            if (briefly and heard.frames) or (heard.prompt and not heard.frames):
                break
        for item in self._node.close():
            self._keep(item)
        heard.counts, heard.refusal = self._node.counts, self._node.mismatch_text

    def _take(self, data: bytes, now: int) -> None:
        heard = self._heard
        heard.received += len(data)
        heard.tail = (heard.tail + data)[-_TAIL:]
        for frame in self._frames.feed(data):
            heard.frames += 1
            heard.node = frame.node if heard.node is None else heard.node
            if frame.node == heard.node:
                for item in self._node.decode_frame(frame, now, LinkCounts(self._damaged())):
                    self._keep(item)
        heard.hello, heard.refusal, heard.damaged = (
            self._node.hello,
            self._node.mismatch_text,
            self._damaged(),
        )
        heard.prompt = heard.tail.endswith(_PROMPTS)

    def _keep(self, item: object) -> None:
        if isinstance(item, ImuBlock):
            self._heard.blocks.append(item)
        elif isinstance(item, HealthReceived):
            self._heard.reports.append(item.health)
        elif isinstance(item, TimeReplyReceived) and item.token in self._sent_ns:
            sent = self._sent_ns.pop(item.token)
            node_ns = (item.received_us + item.sent_us) * 500
            trip = item.arrived_ns - sent - (item.sent_us - item.received_us) * 1000
            self._heard.exchanges.append(((sent + item.arrived_ns) // 2, node_ns, trip))

    def _damaged(self) -> int:
        damage = self._frames.damage
        return damage.crc + damage.cobs + damage.short + damage.oversize

    def _ask(self, message: Message) -> None:
        self._seq = (self._seq + 1) & 0xFFFF
        self._link.write(
            b"\0" + encode_frame(Frame(message.type_id, ANY_NODE, self._seq, encode(message))), ""
        )
