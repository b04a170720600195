"""Decoder of one node's frames to samples in SI units and events; sans-I/O, without a clock of its own."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Generator, Iterator
from typing import assert_never

import numpy as np

from hubodo.earth import STANDARD_GRAVITY
from hubodo.ingest.node.bias_filter import decode_filter_report
from hubodo.ingest.node.boot import (
    BatchTail,
    BootState,
    NodeCounts,
    StreamState,
    count_lost_samples,
    unwrap_first_sample,
)
from hubodo.ingest.node.gaps import GapClassifier, GapGroup, LinkCounts, WireGap
from hubodo.ingest.node.health import report_worsening
from hubodo.ingest.node.outputs import (
    AnswerReceived,
    HealthReceived,
    HelloReceived,
    HighGBlock,
    MagSample,
    NodeOutput,
    SignalReceived,
    TimeReplyReceived,
    WireMismatchReport,
)
from hubodo.ingest.node.wire_batch import RAD_PER_NANO_DEG, WireBatch, convert_to_si, read_batch
from hubodo.log.records import ImuBlock
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
    HighG,
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
    UpdatePiece,
    UpdateStart,
    UpdateState,
)

_HELLO_HEADER = struct.Struct("<I3B")  # fingerprint and version: the same in every message table
_MAX_PENDING_FRAMES = 2048
_MAX_REORDER_FRAMES = 64  # frames by which a datagram may be late
_MAX_SERIALS = 8  # serials remembered per node id: noise on the line could produce any number of them
_SERIAL_TIMEOUT_NS = 15_000_000_000  # three periods of the unsolicited Hello of a node
# Plain integers, because operations on enum members take as long as decoding the rest of a frame.
_OVERRUN_FLAGS = int(BatchFlag.GAP_BEFORE | BatchFlag.FIFO_OVERRUN)
_RATE_CHANGED, _SATURATED = int(BatchFlag.RATE_CHANGED), int(BatchFlag.SATURATED)
_SAMPLE_INDICES = np.arange(256)
_STREAM_NAMES = {
    message.type_id: message.__name__
    for message in (Hello, ImuBatch, Mag, Filter, Health, TimeReply, Signal, HighG)
}

DecoderOutput = NodeOutput | GapGroup | Event


class NodeDecoder:
    """A decoder of the frames of one node on one link, across disconnections and restarts.

    Frames before the first `Hello` are held and decoded once it arrives. Frames that suggest a restart of the
    node (time or sequence numbers run backwards) are held as well until a `Hello` confirms or refutes it.
    """

    def __init__(self, name: str, *, datagrams: bool = False) -> None:
        """Start without a Hello; datagrams: True if the link may deliver frames out of order."""
        self.name = name
        self.counts = NodeCounts()
        self.hello: Hello | None = None
        self.mismatch_text: str | None = None
        self._datagrams = datagrams
        self._boot: BootState | None = None
        self._boot_is_unknown = True  # no Hello yet that shows to which boot the frames belong
        self._pending: deque[tuple[Frame, int, LinkCounts]] = deque()
        self._gaps = GapClassifier(name)
        self._serials_received: dict[
            bytes, int
        ] = {}  # serials on this line, and the time of their newest Hello
        self._disconnections = 0
        self._hello_payload = b""  # payload of the newest Hello
        self._id_is_shared = False  # two nodes use one id

    @property
    def wants_hello(self) -> bool:
        """True while the host should request a `Hello`."""
        return self._boot_is_unknown and self.mismatch_text is None

    def decode_frame(self, frame: Frame, t_ns: int, link_counts: LinkCounts) -> Iterator[DecoderOutput]:
        """Decode one valid frame received at host time `t_ns`; link_counts: the link's counters then."""
        self.counts.frames += 1
        if frame.type_id == Hello.type_id:
            yield from self._handle_hello(frame, t_ns, link_counts)
        elif self.mismatch_text is not None or self._id_is_shared:
            self.counts.frames_undecoded += 1
        elif self._boot_is_unknown:
            self._hold_frame(frame, t_ns, link_counts)
        else:
            yield from self._decode_known(frame, t_ns, link_counts)

    def update_radio_losses(self, frames_lost: int) -> Iterator[DecoderOutput]:
        """Update a radio receiver's counter of incomplete frames of this node."""
        yield from self._gaps.update_radio_losses(frames_lost)

    def note_host_suspension(self, start_ns: int, end_ns: int) -> None:
        """Note that the host was suspended between these host times."""
        self._gaps.note_host_suspension(start_ns, end_ns)

    def tick(self, now_ns: int) -> Iterator[DecoderOutput]:
        """Resolve gaps whose health report is overdue."""
        yield from self._gaps.tick(now_ns)

    def close(self) -> Iterator[DecoderOutput]:
        """Resolve all pending gaps; frames without a `Hello` remain in the raw log only."""
        yield from self._gaps.close()
        self.counts.frames_undecoded += len(self._pending)
        self._pending.clear()

    def _hold_frame(self, frame: Frame, t_ns: int, link_counts: LinkCounts) -> None:
        self._pending.append((frame, t_ns, link_counts))
        if len(self._pending) > _MAX_PENDING_FRAMES:
            self._pending.popleft()
            self.counts.frames_undecoded += 1

    def _handle_hello(self, frame: Frame, t_ns: int, link_counts: LinkCounts) -> Iterator[DecoderOutput]:
        if len(frame.payload) < _HELLO_HEADER.size:
            self.counts.frames_undecoded += 1
            return
        hello = self.hello
        if hello is None or self.mismatch_text is not None or frame.payload != self._hello_payload:
            hello = yield from self._read_hello(frame, t_ns)
        if hello is None:
            return
        self._hello_payload = frame.payload
        self.mismatch_text = None
        yield from self._check_shared_id(hello, t_ns, link_counts)
        if self._id_is_shared:
            return
        yield from self._resolve_boot(hello, t_ns, link_counts)

    def _read_hello(self, frame: Frame, t_ns: int) -> Generator[DecoderOutput, None, Hello | None]:
        """Return the Hello; None where it cannot be decoded or is of another message table."""
        fingerprint, *version = _HELLO_HEADER.unpack_from(frame.payload)
        if fingerprint != FINGERPRINT:
            if self.mismatch_text is None:
                firmware = ".".join(map(str, version))
                text = (
                    f"node {self.name!r} speaks {fingerprint:08x} (firmware {firmware}), "
                    f"host speaks {FINGERPRINT:08x}: flash it with `hubodo flash`, or install its hubodo"
                )
                self.mismatch_text = text
                self.counts.frames_undecoded += len(self._pending)
                self._pending.clear()
                yield WireMismatchReport(text, t_ns)
            return None
        hello = _decode_payload(frame)
        if isinstance(hello, Hello):
            return hello
        self.counts.frames_undecoded += 1
        return None

    def _resolve_boot(self, hello: Hello, t_ns: int, link_counts: LinkCounts) -> Iterator[DecoderOutput]:
        """Assign the held frames to the boot that this Hello identifies, and decode them."""
        before = self._boot
        restarted = before is not None and before.hello.boot_id != hello.boot_id
        if before is None or restarted:
            self._boot = BootState(hello)
        elif before.hello != hello:
            before.hello = hello
        changed = self.hello != hello
        self.hello = hello
        pending, self._pending = self._pending, deque()
        self._boot_is_unknown = False
        if changed or restarted:
            yield HelloReceived(hello, restarted, t_ns)
        if before is not None and restarted:
            yield from self._report_restart(before, hello, t_ns, link_counts)
        for held in pending:
            yield from self._decode_known(*held, boot_confirmed=True)

    def _check_shared_id(self, hello: Hello, t_ns: int, link_counts: LinkCounts) -> Iterator[DecoderOutput]:
        """Report two nodes with one id on one line: their frames cannot be separated."""
        if link_counts.disconnections != self._disconnections:
            self._serials_received, self._disconnections = {}, link_counts.disconnections
        self._serials_received = {
            serial: at_ns
            for serial, at_ns in self._serials_received.items()
            if t_ns - at_ns < _SERIAL_TIMEOUT_NS
        }
        if len(self._serials_received) < _MAX_SERIALS or hello.serial in self._serials_received:
            self._serials_received[hello.serial] = t_ns
        serials = sorted(serial.hex() for serial in self._serials_received)
        is_shared = len(serials) > 1 and not self._datagrams
        if is_shared and not self._id_is_shared:
            self.counts.frames_undecoded += len(self._pending)
            self._pending.clear()
            self._boot_is_unknown = True
            text = (
                f"{self.name}: two nodes with one id on one line, serials {' and '.join(serials)}: their "
                "frames are logged raw, not decoded; give one of them another id (hubodo flash --node)"
            )
            yield Event(t_ns, "conflict", self.name, text, {"node": self.name, "serials": serials})
        self._id_is_shared = is_shared

    def _report_restart(
        self, before: BootState, hello: Hello, t_ns: int, link_counts: LinkCounts
    ) -> Iterator[DecoderOutput]:
        self.counts.restarts += 1
        self._gaps.note_restart()
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
            yield from self._gaps.add(gap, link_counts, link_counts, restart=True)

    def _decode_known(
        self, frame: Frame, t_ns: int, link_counts: LinkCounts, *, boot_confirmed: bool = False
    ) -> Iterator[DecoderOutput]:
        """Decode a frame whose boot is known; boot_confirmed: True if a Hello has just confirmed the boot."""
        boot = self._boot
        assert boot is not None
        stream = boot.streams.get(frame.type_id)
        lost = 0
        if stream is not None:
            lost = (frame.seq - stream.seq - 1) & 0xFFFF
            behind = 0x10000 - lost
            if self._datagrams and behind <= _MAX_REORDER_FRAMES:
                self.counts.frames_late += 1
                return
            if lost >= 0x8000 and not boot_confirmed:
                self._hold_until_hello(frame, t_ns, link_counts)
                return
        message = _decode_payload(frame)
        if message is None:
            self.counts.frames_undecoded += 1
            return
        if isinstance(message, WireBatch):
            if not boot_confirmed and (
                self._clock_jumped(boot, message, t_ns) or not boot.hello.gyro_lsb_ndps
            ):
                self._hold_until_hello(frame, t_ns, link_counts)
                return
            if not boot.hello.gyro_lsb_ndps:
                self.counts.frames_undecoded += 1  # a Hello sent before the IMU was detected
                return
        boot.streams[frame.type_id] = StreamState(frame.seq, t_ns, link_counts)
        self.counts.frames_lost += lost
        if isinstance(message, WireBatch):
            yield from self._decode_batch(boot, message, t_ns, stream, lost, link_counts)
            return
        if lost and stream is not None:
            gap = WireGap(
                _STREAM_NAMES.get(frame.type_id, f"type {frame.type_id}"), stream.t_ns, t_ns, lost, 0
            )
            yield from self._gaps.add(gap, stream.link_counts, link_counts)
        yield from self._decode_report(boot, message, t_ns)

    def _hold_until_hello(self, frame: Frame, t_ns: int, link_counts: LinkCounts) -> None:
        self._boot_is_unknown = True
        self._hold_frame(frame, t_ns, link_counts)

    def _clock_jumped(self, boot: BootState, batch: WireBatch, t_ns: int) -> bool:
        """Return True if the node's clock disagrees with the host's."""
        return boot.tail is not None and not boot.ticks.agrees_with_host(batch.t_us, t_ns)

    def _decode_batch(
        self,
        boot: BootState,
        batch: WireBatch,
        t_ns: int,
        stream: StreamState | None,
        frames_lost: int,
        link_counts: LinkCounts,
    ) -> Iterator[DecoderOutput]:
        count = batch.sample_count
        if not count:
            return
        period = batch.period_ns or round(1e12 / max(boot.hello.rate_mhz, 1))
        tail = boot.tail
        first_ns = unwrap_first_sample(boot, batch, t_ns, frames_lost)
        if tail is not None and stream is not None:
            overrun = bool(batch.flags & _OVERRUN_FLAGS)
            changed = bool(batch.flags & _RATE_CHANGED)
            missing = count_lost_samples(tail, batch.first_index, first_ns, period, overrun, changed)
            if missing or overrun or frames_lost:
                self.counts.samples_lost += missing or 0
                self.counts.gaps += 1
                between = (tail.next_device_ns - tail.period_ns, first_ns)
                gap = WireGap("ImuBatch", stream.t_ns, t_ns, frames_lost, missing, between)
                yield from self._gaps.add(gap, stream.link_counts, link_counts, overrun=overrun)
        if batch.flags & _RATE_CHANGED:
            rate = 1e9 / period
            text = f"{self.name}: sample rate is {rate:.0f} Hz from now on"
            yield Event(t_ns, "rate", self.name, text, {"node": self.name, "rate_hz": round(rate, 2)})
        boot.tail = BatchTail((batch.first_index + count) & 0xFFFF, first_ns + count * period, period, t_ns)
        self.counts.samples += count
        self.counts.saturated_batches += bool(batch.flags & _SATURATED)
        hello = boot.hello
        gyro, accel = convert_to_si(batch.rows, hello)
        steps = batch.temperature_raw * hello.temperature_lsb_udegc + hello.temperature_offset_udegc
        device_ns = first_ns + period * _SAMPLE_INDICES[:count]
        yield ImuBlock(self.name, gyro, accel, steps * 1e-6, t_ns, device_ns)

    def _decode_report(self, boot: BootState, message: AnyMessage, t_ns: int) -> Iterator[DecoderOutput]:
        match message:
            case Mag():
                x, y, z = (value * boot.hello.mag_lsb_ft * 1e-15 for value in message.field_raw)
                yield MagSample(boot.ticks.unwrap(message.t_us, t_ns) * 1000, (x, y, z), t_ns)
            case HighG() if message.samples:
                last_ns = boot.ticks.unwrap(message.t_us, t_ns) * 1000
                ages = np.arange(len(message.samples) - 1, -1, -1, dtype=np.int64)
                accel = np.array(message.samples) * (message.lsb_ng * 1e-9 * STANDARD_GRAVITY)
                yield HighGBlock(last_ns - ages * message.period_ns, accel, t_ns)
            case TimeReply():
                received = boot.ticks.unwrap(message.received_us, t_ns)
                sent = boot.ticks.unwrap(message.sent_us, t_ns)
                yield TimeReplyReceived(message.token, received, sent, t_ns)
            case Health():
                yield from self._gaps.update_dropped(message.frames_dropped)
                yield from report_worsening(self.name, boot.health, message, t_ns)
                boot.health = message
                yield HealthReceived(message, boot.ticks.unwrap(message.t_us, t_ns) * 1000, t_ns)
            case Filter():
                gyro_lsb = boot.hello.gyro_lsb_ndps * RAD_PER_NANO_DEG
                if gyro_lsb:  # without an IMU there is no filter
                    device_ns = boot.ticks.unwrap(message.t_us, t_ns) * 1000
                    yield decode_filter_report(message, device_ns, gyro_lsb, t_ns)
            case Signal():
                yield SignalReceived(message, boot.ticks.unwrap(message.t_us, t_ns) * 1000, t_ns)
            case Ack() | Nack():
                reason = message.reason if isinstance(message, Nack) else None
                yield AnswerReceived(message.request, message.request_seq, reason, t_ns)
            case Hello() | ImuBatch() | HighG():
                return  # handled before
            case TimeRequest() | Ping() | SetConfig() | Start() | Stop() | BiasInit() | Reboot() | GetHello():
                return  # sent by another host on a shared line
            case UpdateState() | UpdateStart() | UpdatePiece():
                return  # between `hubodo flash` and the node
            case _:
                assert_never(message)


def _decode_payload(frame: Frame) -> AnyMessage | WireBatch | None:
    if frame.type_id == ImuBatch.type_id:
        return read_batch(frame.payload)
    try:
        return decode(frame.type_id, frame.payload)
    except PayloadError:
        return None
