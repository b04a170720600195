"""A computer in virtual time whose nodes send prepared samples for days, without ports, at full speed."""

from __future__ import annotations

import heapq
import math
import struct
from collections import deque
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np

from hubodo.ingest.link.link import Chunk, LinkUp
from hubodo.ingest.link.ports import DeviceLister, PortName
from hubodo.ingest.live.host_clock import ClockState
from hubodo.units import NS_PER_S
from hubowire import FINGERPRINT, Frame, FrameDecoder, encode, encode_frame
from hubowire.messages import Filter, GetHello, Health, Hello, ImuBatch, Message, TimeReply, TimeRequest

TICKS = 1 << 30
_DPS, _MG = 0.07, 0.488
_HEAD = struct.Struct("<IIHhBB")
_LATE_NS = 1_500_000
_START_NS = 1_790_000_000 * NS_PER_S


class SteadyNode:
    """A wheel node at rate_hz that alternately turns for ten minutes and stands still for five.

    sent: number of samples so far. ppm: rate error of its clock. outages: (from, to) in s during which the
    node has no power; its clock, indices and boot id begin again after each.
    """

    def __init__(
        self,
        node_id: int,
        rate_hz: float,
        batch: int,
        ppm: float,
        outages: tuple[tuple[float, float], ...] = (),
    ) -> None:
        self.node_id, self.rate_hz, self.batch = node_id, rate_hz, batch
        self.sent = 0
        self.outages = outages
        self._boot_id, self._started = 77, 0.0
        self._fast = 1 + ppm * 1e-6
        self._seqs: dict[int, int] = {}
        self._decoder = FrameDecoder()
        self._turning = _bodies(node_id, batch, 208)
        self._resting = _bodies(node_id + 64, batch, 208, turning=False)

    def is_off(self, t: float) -> bool:
        """Return True in an outage, t by the node's clock since the start; restart the node after one."""
        if any(start <= t < end for start, end in self.outages):
            return True
        started = max((end for _, end in self.outages if end <= t), default=0.0)
        if started != self._started:
            self._started, self._boot_id = started, self._boot_id + 1
            self._seqs.clear()
        return False

    def batch_at(self, k: int) -> bytes:
        """Return batch number k as on the wire; nothing in an outage."""
        index = k * self.batch
        t = index / self.rate_hz
        if self.is_off(t):
            return b""
        bodies = self._turning if t % 900 > 300 else self._resting
        own = index - math.ceil(self._started * self.rate_hz / self.batch) * self.batch
        t_us = int((t - self._started) * 1e6) % TICKS
        head = _HEAD.pack(t_us, round(1e9 / self.rate_hz), own & 0xFFFF, 16, 0, self.batch)
        self.sent += self.batch
        hello = self._message(self.hello()) if own == 0 and index else b""
        return hello + self._wire(ImuBatch.type_id, head + bodies[k % len(bodies)])

    def reports(self, t: float) -> bytes:
        """Return the reports that the node sends each second, at t by its clock."""
        if self.is_off(t):
            return b""
        t_us = int((t - self._started) * 1e6) % TICKS
        health = Health(t_us, 3700, 0, 0, 0, 0, 0, 0, 0, 1, 900, 1, 50_000, 40)
        report = Filter(t_us, 2, 0, 2000, (256, 0, 0), (9, 9, 9), (256, 0, 1024), (41, 41, 82))
        return self._message(health) + self._message(report)

    def answers(self, data: bytes, t: float) -> bytes:
        """Return the answers to the bytes of the host, at t by the node's clock."""
        replies = b""
        if self.is_off(t):
            return replies
        for frame in self._decoder.feed(data):
            if frame.type_id == GetHello.type_id:
                replies += self._message(self.hello())
            elif frame.type_id == TimeRequest.type_id:
                now = int((t - self._started) * 1e6) % TICKS
                replies += self._message(TimeReply(frame.payload, now, now))
        return replies

    def ticks(self, t: float) -> float:
        """Return the node's ticks for host seconds since the start."""
        return t * self._fast

    def hello(self) -> Hello:
        """Return the node's Hello."""
        return Hello(
            FINGERPRINT, (0, 1, 0), bytes([self.node_id]) * 8, self._boot_id, 0, 1, int(self.rate_hz * 1000),
            2000, 16, 70_000_000, 488_000, 62_500, 25_000_000, 0, self.batch, 0, 40, ((0x6B, 0x69, 1),),
        )  # fmt: skip

    def _message(self, message: Message) -> bytes:
        return self._wire(message.type_id, encode(message))

    def _wire(self, type_id: int, payload: bytes) -> bytes:
        seq = self._seqs.get(type_id, 0)
        self._seqs[type_id] = (seq + 1) & 0xFFFF
        return encode_frame(Frame(type_id, self.node_id, seq, payload))


def _bodies(seed: int, batch: int, turn: int, *, turning: bool = True) -> list[bytes]:
    """Return samples of whole turns of a wheel, `turn` samples each, in batches, with sensor noise."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(turn * batch) / turn * turning
    gyro = np.zeros((len(angle), 3))
    gyro[:, 2] = turning * 360 * 416 / turn / _DPS
    accel = np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1) * 1000 / _MG
    rows = np.hstack([gyro + rng.normal(0, 1.5, gyro.shape), accel + rng.normal(0, 4, accel.shape)])
    raw = np.rint(rows).astype("<i2").reshape(-1, batch, 6)
    return [part.tobytes() for part in raw]


class SteadyLink:
    """The link to one node."""

    def __init__(self, label: str, node: SteadyNode, computer: SteadyComputer) -> None:
        self.label, self._node, self._computer = label, node, computer

    def open_now(self) -> None:
        self._computer.put(LinkUp(self.label, self._computer.now_ns(), self.label, False))

    def start(self) -> None:
        self._computer.start(self.label, self._node)

    def send(self, data: bytes, to: str = "") -> bool:
        self._computer.ask(self.label, self._node, data)
        return True

    def request_stop(self) -> None: ...

    def stop(self, timeout_s: float = 0.0) -> None: ...


class SteadyComputer:
    """A `Computer` with prepared nodes; passed: called once per virtual minute with the elapsed hours."""

    def __init__(
        self, nodes: dict[str, SteadyNode], passed: Callable[[float], None] = lambda t: None
    ) -> None:
        """Start with these nodes, by label of their port."""
        self.nodes, self._passed = nodes, passed
        self._start_ns = self._now_ns = _START_NS
        self._next_minute = 60.0
        self._news: deque[Any] = deque()
        self._due: list[tuple[int, int, str, Callable[[], bytes], int]] = []
        self._order = count()

    def now_ns(self) -> int:
        return self._now_ns

    def wall_ns(self) -> int:
        return self._now_ns

    def clock_state(self) -> ClockState:
        return ClockState.UNKNOWN

    def put(self, item: Any) -> None:
        self._news.append(item)

    def create_link(self, port: PortName, label: str, baud: int, lister: DeviceLister) -> SteadyLink:
        return SteadyLink(label, self.nodes[label], self)

    def start(self, label: str, node: SteadyNode) -> None:
        """Start sending."""
        self._batch(label, node, 0)
        self._report(label, node, 1)

    def ask(self, label: str, node: SteadyNode, data: bytes) -> None:
        """Pass bytes to a node; its answers arrive 1 ms later."""
        t = node.ticks((self._now_ns - self._start_ns) / NS_PER_S + 0.0005)
        self._at(self._now_ns + 1_000_000, label, lambda: node.answers(data, t))

    def next_report(self, timeout_s: float) -> Any:
        if self._news:
            return self._news.popleft()
        until = self._now_ns + int(timeout_s * NS_PER_S)
        if not self._due or self._due[0][0] > until:
            self._now_ns = until
            return None
        t_ns, _, label, body, _ = heapq.heappop(self._due)
        self._now_ns = max(t_ns, self._now_ns)
        if (t_ns - self._start_ns) / NS_PER_S >= self._next_minute:
            self._passed(self._next_minute / 3600)
            self._next_minute += 60.0
        return Chunk(label, self._now_ns, body(), "")

    def _batch(self, label: str, node: SteadyNode, k: int) -> None:
        t = (k + 1) * node.batch / node.rate_hz / node.ticks(1.0)

        def body() -> bytes:
            self._batch(label, node, k + 1)
            return node.batch_at(k)

        self._at(self._start_ns + int(t * NS_PER_S) + _LATE_NS, label, body)

    def _report(self, label: str, node: SteadyNode, second: int) -> None:
        def body() -> bytes:
            self._report(label, node, second + 1)
            return node.reports(node.ticks(second))

        self._at(self._start_ns + second * NS_PER_S + _LATE_NS, label, body)

    def _at(self, t_ns: int, label: str, body: Callable[[], bytes]) -> None:
        heapq.heappush(self._due, (t_ns, next(self._order), label, body, 0))
