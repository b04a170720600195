"""Frames of one node to samples in SI units and events, without I/O and without a clock of its own."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Generator, Iterator
from typing import assert_never

import numpy as np

from hubodo.ingest.node.bias_filter import filter_seen
from hubodo.ingest.node.boot import (
    BatchTail,
    Boot,
    NodeCounts,
    StreamPlace,
    first_sample_ns,
    samples_lost,
)
from hubodo.ingest.node.gaps import GapLedger, GapsSeen, LinkCounts, WireGap
from hubodo.ingest.node.health import worsened
from hubodo.ingest.node.samples import (
    AnswerSeen,
    HealthSeen,
    HelloSeen,
    ImuBlock,
    MagSample,
    Refused,
    Sample,
    SignalSeen,
    TimeReplySeen,
)
from hubodo.ingest.node.scale import RAD_PER_NANO_DEG
from hubodo.ingest.node.wire_batch import WireBatch, in_si, read_batch
from hubodo.recording import Event
from hubowire import FINGERPRINT, Frame, PayloadError, decode
from hubowire.messages import (
    Ack,
    AnyMessage,
    BatchFlag,
    BiasInit,
    Filter,
    GetHello,
    Health,
    Hello,
    ImuBatch,
    Mag,
    Nack,
    Ping,
    Reboot,
    ResetCause,
    SetConfig,
    Signal,
    Start,
    Stop,
    TimeReply,
    TimeRequest,
)

_HELLO_HEAD = struct.Struct("<I3B")  # fixed for every version of the table
_MAX_PENDING = 2048
_REORDER = 64  # frames a datagram may come late
_MAX_SERIALS = 8  # of two nodes that speak as one; a babbling line may say any number
_GONE_NS = 15_000_000_000  # three of the periods in which a node says Hello by itself
# Plain integers: an enumeration's members take as long to combine as the rest of a frame.
_OVERRUN_FLAGS = int(BatchFlag.GAP_BEFORE | BatchFlag.FIFO_OVERRUN)
_RATE_CHANGED, _SATURATED = int(BatchFlag.RATE_CHANGED), int(BatchFlag.SATURATED)
_COUNTS = np.arange(256)
_NAMES = {
    message.type_id: message.__name__ for message in (Hello, ImuBatch, Mag, Filter, Health, TimeReply, Signal)
}

Output = Sample | GapsSeen | Event


class NodeDecoder:
    """Decodes the frames of one node on one link, across unplugs and restarts.

    Frames before the first `Hello` are kept and decoded when it comes. Frames that look like another
    start of the node (time or sequence numbers run backwards) are kept as well until a `Hello` tells.
    """

    def __init__(self, name: str, *, datagrams: bool = False) -> None:
        """name: for events; datagrams: whether the link may deliver frames out of order."""
        self.name = name
        self.counts = NodeCounts()
        self.hello: Hello | None = None
        self.refusal: str | None = None
        self._datagrams = datagrams
        self._boot: Boot | None = None
        self._doubt = True  # no Hello yet that settles which start these frames belong to
        self._pending: deque[tuple[Frame, int, LinkCounts]] = deque()
        self._gaps = GapLedger(name)
        self._heard: dict[bytes, int] = {}  # serials on this line, and when each last said Hello
        self._downs = 0
        self._told = b""  # the newest Hello as it came
        self._shared = False  # two nodes answer to one id

    @property
    def wants_hello(self) -> bool:
        """Whether the host should ask for `Hello`."""
        return self._doubt and self.refusal is None

    def frame(self, frame: Frame, t_ns: int, link: LinkCounts) -> Iterator[Output]:
        """One undamaged frame that arrived at host time `t_ns`; `link` as it stands with this frame."""
        self.counts.frames += 1
        if frame.type_id == Hello.type_id:
            yield from self._hello(frame, t_ns, link)
        elif self.refusal is not None or self._shared:
            self.counts.frames_unread += 1
        elif self._doubt:
            self._keep(frame, t_ns, link)
        else:
            yield from self._known(frame, t_ns, link)

    def radio(self, frames_lost: int) -> Iterator[Output]:
        """A receiver's counter of this node's frames that did not come whole."""
        yield from self._gaps.radio(frames_lost)

    def resumed(self, begin_ns: int, end_ns: int) -> None:
        """The computer stood still between these host times."""
        self._gaps.resumed(begin_ns, end_ns)

    def tick(self, now_ns: int) -> Iterator[Output]:
        """Settles what waited for a report that did not come."""
        yield from self._gaps.tick(now_ns)

    def close(self) -> Iterator[Output]:
        """Settles all that waits; what never met a `Hello` stays in the raw log alone."""
        yield from self._gaps.close()
        self.counts.frames_unread += len(self._pending)
        self._pending.clear()

    def _keep(self, frame: Frame, t_ns: int, link: LinkCounts) -> None:
        self._pending.append((frame, t_ns, link))
        if len(self._pending) > _MAX_PENDING:
            self._pending.popleft()
            self.counts.frames_unread += 1

    def _hello(self, frame: Frame, t_ns: int, link: LinkCounts) -> Iterator[Output]:
        if len(frame.payload) < _HELLO_HEAD.size:
            self.counts.frames_unread += 1
            return
        hello = self.hello
        if hello is None or self.refusal is not None or frame.payload != self._told:
            hello = yield from self._read_hello(frame, t_ns)
        if hello is None:
            return
        self._told = frame.payload
        self.refusal = None
        yield from self._alone(hello, t_ns, link)
        if self._shared:
            return
        yield from self._settled(hello, t_ns, link)

    def _read_hello(self, frame: Frame, t_ns: int) -> Generator[Output, None, Hello | None]:
        """What a Hello says; None where it cannot be read, or is of another table."""
        fingerprint, *version = _HELLO_HEAD.unpack_from(frame.payload)
        if fingerprint != FINGERPRINT:
            if self.refusal is None:
                text = (
                    f"node {self.name!r} speaks {fingerprint:08x} (firmware {'.'.join(map(str, version))}), "
                    f"host speaks {FINGERPRINT:08x}: flash it with `hubodo flash`, or install its hubodo"
                )
                self.refusal = text
                self.counts.frames_unread += len(self._pending)
                self._pending.clear()
                yield Refused(text, t_ns)
            return None
        hello = _decoded(frame)
        if isinstance(hello, Hello):
            return hello
        self.counts.frames_unread += 1
        return None

    def _settled(self, hello: Hello, t_ns: int, link: LinkCounts) -> Iterator[Output]:
        """It is known now which start of the node the frames belong to."""
        before = self._boot
        restarted = before is not None and before.hello.boot_id != hello.boot_id
        if before is None or restarted:
            self._boot = Boot(hello)
        elif before.hello != hello:
            before.hello = hello
        changed = self.hello != hello
        self.hello = hello
        pending, self._pending = self._pending, deque()
        self._doubt = False
        if changed or restarted:
            yield HelloSeen(hello, restarted, t_ns)
        if before is not None and restarted:
            yield from self._restart(before, hello, t_ns, link)
        for kept in pending:
            yield from self._known(*kept, sure=True)

    def _alone(self, hello: Hello, t_ns: int, link: LinkCounts) -> Iterator[Output]:
        """Notices two nodes that speak as one: which frame is whose, nobody can tell."""
        if link.disconnections != self._downs:
            self._heard, self._downs = {}, link.disconnections
        self._heard = {serial: at_ns for serial, at_ns in self._heard.items() if t_ns - at_ns < _GONE_NS}
        if len(self._heard) < _MAX_SERIALS or hello.serial in self._heard:
            self._heard[hello.serial] = t_ns
        heard = sorted(serial.hex() for serial in self._heard)
        shared = len(heard) > 1 and not self._datagrams
        if shared and not self._shared:
            self.counts.frames_unread += len(self._pending)
            self._pending.clear()
            self._doubt = True
            text = (
                f"{self.name}: two nodes with one id on one line, serials {' and '.join(heard)}: their "
                "frames are kept raw, not decoded; give one of them another id (hubodo flash --node)"
            )
            yield Event(t_ns, "conflict", self.name, text, {"node": self.name, "serials": heard})
        self._shared = shared

    def _restart(self, before: Boot, hello: Hello, t_ns: int, link: LinkCounts) -> Iterator[Output]:
        self.counts.restarts += 1
        self._gaps.restarted()
        cause = (
            ResetCause(hello.reset_cause).name.lower() if hello.reset_cause in set(ResetCause) else "unknown"
        )
        yield Event(
            t_ns,
            "reset",
            self.name,
            f"{self.name}: the node has restarted, reset cause {cause.replace('_', ' ')}",
            {"node": self.name, "reset_cause": cause, "boot_id": hello.boot_id},
        )
        if before.tail is not None:
            self.counts.gaps += 1
            gap = WireGap("ImuBatch", before.tail.t_ns, t_ns, 0, None)
            yield from self._gaps.add(gap, link, link, restart=True)

    def _known(self, frame: Frame, t_ns: int, link: LinkCounts, *, sure: bool = False) -> Iterator[Output]:
        """A frame whose scales are known. sure: a Hello has just said that this is the same start."""
        boot = self._boot
        assert boot is not None
        stream = boot.streams.get(frame.type_id)
        lost = 0
        if stream is not None:
            lost = (frame.seq - stream.seq - 1) & 0xFFFF
            behind = 0x10000 - lost
            if self._datagrams and behind <= _REORDER:
                self.counts.frames_late += 1
                return
            if lost >= 0x8000 and not sure:
                self._suspect(frame, t_ns, link)
                return
        message = _decoded(frame)
        if message is None:
            self.counts.frames_unread += 1
            return
        if isinstance(message, WireBatch):
            if not sure and (self._jumped(boot, message, t_ns) or not boot.hello.gyro_lsb_ndps):
                self._suspect(frame, t_ns, link)
                return
            if not boot.hello.gyro_lsb_ndps:
                self.counts.frames_unread += 1  # a Hello from before the IMU was found
                return
        boot.streams[frame.type_id] = StreamPlace(frame.seq, t_ns, link)
        self.counts.frames_lost += lost
        if isinstance(message, WireBatch):
            yield from self._batch(boot, message, t_ns, stream, lost, link)
            return
        if lost and stream is not None:
            gap = WireGap(_NAMES.get(frame.type_id, f"type {frame.type_id}"), stream.t_ns, t_ns, lost, 0)
            yield from self._gaps.add(gap, stream.link, link)
        yield from self._small(boot, message, t_ns)

    def _suspect(self, frame: Frame, t_ns: int, link: LinkCounts) -> None:
        self._doubt = True
        self._keep(frame, t_ns, link)

    def _jumped(self, boot: Boot, batch: WireBatch, t_ns: int) -> bool:
        """Whether the node's clock is not where the host's says it must be."""
        return boot.tail is not None and not boot.ticks.agrees(batch.t_us, t_ns)

    def _batch(
        self,
        boot: Boot,
        batch: WireBatch,
        t_ns: int,
        stream: StreamPlace | None,
        frames_lost: int,
        link: LinkCounts,
    ) -> Iterator[Output]:
        count = batch.samples
        if not count:
            return
        period = batch.period_ns or round(1e12 / max(boot.hello.rate_mhz, 1))
        tail = boot.tail
        first_ns = first_sample_ns(boot, batch, t_ns, frames_lost)
        if tail is not None and stream is not None:
            overrun = bool(batch.flags & _OVERRUN_FLAGS)
            missing = samples_lost(tail, batch.first, first_ns, period, overrun)
            if missing or overrun or frames_lost:
                self.counts.samples_lost += missing or 0
                self.counts.gaps += 1
                between = (tail.next_device_ns - tail.period_ns, first_ns)
                gap = WireGap("ImuBatch", stream.t_ns, t_ns, frames_lost, missing, between)
                yield from self._gaps.add(gap, stream.link, link, overrun=overrun)
        if batch.flags & _RATE_CHANGED:
            rate = 1e9 / period
            text = f"{self.name}: samples at {rate:.0f} Hz from here on"
            yield Event(t_ns, "rate", self.name, text, {"node": self.name, "rate_hz": round(rate, 2)})
        boot.tail = BatchTail((batch.first + count) & 0xFFFF, first_ns + count * period, period, t_ns)
        self.counts.samples += count
        self.counts.saturated_batches += bool(batch.flags & _SATURATED)
        hello = boot.hello
        gyro, accel = in_si(batch.rows, hello)
        yield ImuBlock(
            device_ns=first_ns + period * _COUNTS[:count],
            gyro=gyro,
            accel=accel,
            temperature=(batch.temperature_raw * hello.temperature_lsb_udegc + hello.temperature_offset_udegc)
            * 1e-6,
            raw=batch.rows,
            received_ns=t_ns,
        )

    def _small(self, boot: Boot, message: AnyMessage, t_ns: int) -> Iterator[Output]:
        match message:
            case Mag():
                x, y, z = (value * boot.hello.mag_lsb_ft * 1e-15 for value in message.field_raw)
                yield MagSample(boot.ticks.unwrap(message.t_us, t_ns) * 1000, (x, y, z), t_ns)
            case TimeReply():
                received = boot.ticks.unwrap(message.received_us, t_ns)
                sent = boot.ticks.unwrap(message.sent_us, t_ns)
                yield TimeReplySeen(message.token, received, sent, t_ns)
            case Health():
                yield from self._gaps.health(message.frames_dropped)
                yield from worsened(self.name, boot.health, message, t_ns)
                boot.health = message
                yield HealthSeen(message, boot.ticks.unwrap(message.t_us, t_ns) * 1000, t_ns)
            case Filter():
                step = boot.hello.gyro_lsb_ndps * RAD_PER_NANO_DEG
                if step:  # without an IMU there is nothing to filter
                    device_ns = boot.ticks.unwrap(message.t_us, t_ns) * 1000
                    yield filter_seen(message, device_ns, step, t_ns)
            case Signal():
                yield SignalSeen(message, boot.ticks.unwrap(message.t_us, t_ns) * 1000, t_ns)
            case Ack() | Nack():
                reason = message.reason if isinstance(message, Nack) else None
                yield AnswerSeen(message.request, message.request_seq, reason, t_ns)
            case Hello() | ImuBatch():
                return  # taken before
            case TimeRequest() | Ping() | SetConfig() | Start() | Stop() | BiasInit() | Reboot() | GetHello():
                return  # another host on a shared line
            case _:
                assert_never(message)


def _decoded(frame: Frame) -> AnyMessage | WireBatch | None:
    if frame.type_id == ImuBatch.type_id:
        return read_batch(frame.payload)
    try:
        return decode(frame.type_id, frame.payload)
    except PayloadError:
        return None
