"""Frames of one node to samples in SI units and events, without I/O and without a clock of its own."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from hubodo.ingest.node.clock import TickUnwrapper
from hubodo.ingest.node.gaps import GapLedger, LinkCounts, WireGap
from hubodo.ingest.node.health import worsened
from hubodo.ingest.node.samples import (
    FilterSeen,
    HealthSeen,
    HelloSeen,
    ImuBlock,
    MagSample,
    Refused,
    Sample,
    TimeReplySeen,
)
from hubodo.recording import Event
from hubowire import FINGERPRINT, Frame, Message, PayloadError, decode
from hubowire.messages import BatchFlag, Filter, Health, Hello, ImuBatch, Mag, ResetCause, TimeReply

G = 9.80665
RAD_PER_NANO_DEG = math.pi / 180 * 1e-9

_HELLO_HEAD = struct.Struct("<I3B")  # fixed for every version of the table
_MAX_PENDING = 2048
_REORDER = 64  # frames a datagram may come late
_CLOCK_JUMP_US = 3_000_000
_OVERRUN_FLAGS = BatchFlag.GAP_BEFORE | BatchFlag.FIFO_OVERRUN
_NAMES = {message.type_id: message.__name__ for message in (Hello, ImuBatch, Mag, Filter, Health, TimeReply)}

Output = Sample | Event


@dataclass(slots=True)
class NodeCounts:
    """What has come from a node, and what has not."""

    frames: int = 0
    frames_lost: int = 0
    frames_late: int = 0
    frames_unread: int = 0  # no Hello in time, refused, or a payload shorter than its message
    samples: int = 0
    samples_lost: int = 0
    saturated_batches: int = 0
    gaps: int = 0
    restarts: int = 0


@dataclass(slots=True)
class _Stream:
    """Where one message type stood at its newest frame."""

    seq: int
    t_ns: int
    link: LinkCounts


@dataclass(slots=True)
class _Tail:
    """Where the samples stood after the newest batch."""

    next_index: int
    next_device_ns: int
    period_ns: int
    t_ns: int


@dataclass(slots=True)
class _Boot:
    """What is true from one start of the node to its next."""

    hello: Hello
    ticks: TickUnwrapper = field(default_factory=TickUnwrapper)
    streams: dict[int, _Stream] = field(default_factory=dict)
    tail: _Tail | None = None
    health: Health | None = None


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
        self._boot: _Boot | None = None
        self._doubt = True  # no Hello yet that settles which start these frames belong to
        self._pending: deque[tuple[Frame, int, LinkCounts]] = deque()
        self._gaps = GapLedger(name)

    @property
    def wants_hello(self) -> bool:
        """Whether the host should ask for `Hello`."""
        return self._doubt and self.refusal is None

    def frame(self, frame: Frame, t_ns: int, link: LinkCounts) -> Iterator[Output]:
        """One undamaged frame that arrived at host time `t_ns`; `link` as it stands with this frame."""
        self.counts.frames += 1
        if frame.type_id == Hello.type_id:
            yield from self._hello(frame, t_ns, link)
        elif self.refusal is not None:
            self.counts.frames_unread += 1
        elif self._doubt:
            self._keep(frame, t_ns, link)
        else:
            yield from self._known(frame, t_ns, link)

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
            return
        hello = _decoded(frame)
        if not isinstance(hello, Hello):
            self.counts.frames_unread += 1
            return
        self.refusal = None
        before = self._boot
        restarted = before is not None and before.hello.boot_id != hello.boot_id
        if before is None or restarted:
            self._boot = _Boot(hello)
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

    def _restart(self, before: _Boot, hello: Hello, t_ns: int, link: LinkCounts) -> Iterator[Output]:
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
        if isinstance(message, ImuBatch):
            if not sure and (self._jumped(boot, message, t_ns) or not boot.hello.gyro_lsb_ndps):
                self._suspect(frame, t_ns, link)
                return
            if not boot.hello.gyro_lsb_ndps:
                self.counts.frames_unread += 1  # a Hello from before the IMU was found
                return
        boot.streams[frame.type_id] = _Stream(frame.seq, t_ns, link)
        self.counts.frames_lost += lost
        if isinstance(message, ImuBatch):
            yield from self._batch(boot, message, t_ns, stream, lost, link)
            return
        if lost and stream is not None:
            gap = WireGap(_NAMES.get(frame.type_id, f"type {frame.type_id}"), stream.t_ns, t_ns, lost, 0)
            yield from self._gaps.add(gap, stream.link, link)
        yield from self._small(boot, message, t_ns)

    def _suspect(self, frame: Frame, t_ns: int, link: LinkCounts) -> None:
        self._doubt = True
        self._keep(frame, t_ns, link)

    def _jumped(self, boot: _Boot, batch: ImuBatch, t_ns: int) -> bool:
        """Whether the node's clock is not where the host's says it must be."""
        if boot.tail is None:
            return False
        return abs(boot.ticks.ahead(batch.t_us, t_ns)) > _CLOCK_JUMP_US + (t_ns - boot.tail.t_ns) // 50_000

    def _batch(
        self,
        boot: _Boot,
        batch: ImuBatch,
        t_ns: int,
        stream: _Stream | None,
        frames_lost: int,
        link: LinkCounts,
    ) -> Iterator[Output]:
        count = len(batch.samples)
        if not count:
            return
        period = batch.period_ns or round(1e12 / max(boot.hello.rate_mhz, 1))
        first_ns = boot.ticks.unwrap(batch.t_us, t_ns) * 1000
        tail = boot.tail
        if tail is not None and stream is not None:
            overrun = bool(batch.flags & _OVERRUN_FLAGS)
            samples_lost = _samples_lost(tail, batch.index, first_ns, period, overrun)
            if samples_lost or overrun or frames_lost:
                self.counts.samples_lost += samples_lost or 0
                self.counts.gaps += 1
                between = (tail.next_device_ns - tail.period_ns, first_ns)
                gap = WireGap("ImuBatch", stream.t_ns, t_ns, frames_lost, samples_lost, between)
                yield from self._gaps.add(gap, stream.link, link, overrun=overrun)
        boot.tail = _Tail((batch.index + count) & 0xFFFF, first_ns + count * period, period, t_ns)
        self.counts.samples += count
        self.counts.saturated_batches += bool(batch.flags & BatchFlag.SATURATED)
        raw = np.array(batch.samples, np.int16)
        hello = boot.hello
        yield ImuBlock(
            device_ns=first_ns + period * np.arange(count, dtype=np.int64),
            gyro=raw[:, :3].astype(np.float64) * (hello.gyro_lsb_ndps * RAD_PER_NANO_DEG),
            accel=raw[:, 3:].astype(np.float64) * (hello.accel_lsb_ng * 1e-9 * G),
            temperature=(batch.temperature_raw * hello.temperature_lsb_udegc + hello.temperature_offset_udegc)
            * 1e-6,
            raw=raw,
            received_ns=t_ns,
        )

    def _small(self, boot: _Boot, message: Message, t_ns: int) -> Iterator[Output]:
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
                yield HealthSeen(message, t_ns)
            case Filter():
                yield FilterSeen(message, t_ns)
            case _:
                return


def _decoded(frame: Frame) -> Message | None:
    try:
        return decode(frame.type_id, frame.payload)
    except PayloadError:
        return None


def _samples_lost(tail: _Tail, index: int, first_ns: int, period_ns: int, overrun: bool) -> int | None:
    """Samples between two batches: exact by number, with the device time telling whole turns of 2^16.

    None where the chip itself lost them for so long that the node began to count anew: then numbers and
    time disagree.
    """
    by_index = (index - tail.next_index) & 0xFFFF
    by_time = (first_ns - tail.next_device_ns) / period_ns
    lost = by_index + 0x10000 * round((by_time - by_index) / 0x10000)
    if overrun and abs(by_time - lost) > 16 + 0.05 * abs(by_time):
        return None
    return max(lost, 0)
