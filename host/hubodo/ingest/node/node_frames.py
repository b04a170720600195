"""Grouping of many frames by node: IMU batches as arrays, other frames one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.node.bulk import FrameGroup
from hubodo.ingest.node.clock import TICK_PERIOD_US
from hubowire import Frame
from hubowire.codec import payload_layout
from hubowire.messages import BatchFlag, ImuBatch

Times = NDArray[np.int64]
ArrivalLookup = Callable[[Times], tuple[Times, Times]]
"""Map (n,) end offsets of frames to (n,) host times of arrival, ns, and (n,) damaged frames before them."""

_BATCH_HEADER = np.dtype(
    [
        ("t_us", "<u4"),
        ("period_ns", "<u4"),
        ("index", "<u2"),
        ("temperature_raw", "<i2"),
        ("flags", "u1"),
        ("count", "u1"),
    ]
)
_SAMPLE_BYTES = 12
MAX_CLOCK_STEP_US = 1_000_000
"""Maximum difference between node clock and host clock from one batch to the next."""
_MAX_GAP_SAMPLES = 30_000  # a longer gap is ambiguous with sample numbers modulo 2^16
_DISCONTINUITY_FLAGS = BatchFlag.GAP_BEFORE | BatchFlag.FIFO_OVERRUN | BatchFlag.RATE_CHANGED


@dataclass(frozen=True, slots=True, eq=False)
class Batches:
    """Valid IMU batches of one node in order of arrival, as arrays (n,).

    Attributes
    ----------
    end_offset, t_ns, damaged
        Position in the stream, host time of arrival and damaged frames before it: see `ArrivalLookup`.
    first_rows
        First row of each batch in `rows`.
    rows
        (N, 6) int16 raw samples of all batches.
    is_contiguous
        True where a batch continues the previous one without loss, flag or clock jump.
    has_counted_gap
        True where a batch continues the previous one after lost frames with `missing_samples` samples.
    start_device_ns, device_ns
        (n,) device time of each batch and (N,) of each sample since the first batch; differences are valid
        across batches that are contiguous or have a counted gap.
    """

    end_offset: Times
    t_ns: Times
    damaged: Times
    seq: Times
    t_us: Times
    period_ns: Times
    index: Times
    temperature_raw: Times
    flags: Times
    count: Times
    first_rows: Times
    rows: NDArray[np.int16]
    is_contiguous: NDArray[np.bool_]
    has_counted_gap: NDArray[np.bool_]
    missing_samples: Times
    start_device_ns: Times
    device_ns: Times

    def __len__(self) -> int:
        return len(self.end_offset)


@dataclass(frozen=True, slots=True)
class OtherFrame:
    """A frame other than a valid IMU batch, with its offset, arrival time and damage count."""

    end_offset: int
    t_ns: int
    damaged: int
    frame: Frame


@dataclass(slots=True)
class NodeFrames:
    """Frames of one node: its valid batches, and all others in order of arrival."""

    node: int
    batches: Batches
    others: list[OtherFrame] = field(default_factory=list)

    def batch_frame(self, k: int) -> Frame:
        """Return batch k as a frame."""
        batches = self.batches
        head = np.zeros((), _BATCH_HEADER)
        for name in _BATCH_HEADER.names or ():
            head[name] = getattr(batches, name)[k]
        rows = batches.rows[batches.first_rows[k] : batches.first_rows[k] + batches.count[k]]
        return Frame(ImuBatch.type_id, self.node, int(batches.seq[k]), head.tobytes() + rows.tobytes())


def group_by_node(groups: Iterable[FrameGroup], arrival: ArrivalLookup) -> dict[int, NodeFrames]:
    """Return the frames of all groups by node id, in order of arrival."""
    batches: dict[int, list[FrameGroup]] = {}
    others: dict[int, list[OtherFrame]] = {}
    for group in groups:
        other_rows = np.arange(len(group.seq))
        node_others = others.setdefault(group.node, [])
        if group.type_id == ImuBatch.type_id and group.payload.shape[1] >= _BATCH_HEADER.itemsize:
            # The last byte of the header is the number of samples.
            count = group.payload[:, _BATCH_HEADER.itemsize - 1].astype(np.int64)
            is_valid = (count > 0) & (
                _BATCH_HEADER.itemsize + count * _SAMPLE_BYTES <= group.payload.shape[1]
            )
            if is_valid.any():
                valid_group = group if is_valid.all() else group.select(np.flatnonzero(is_valid))
                batches.setdefault(group.node, []).append(valid_group)
            other_rows = np.flatnonzero(~is_valid)
        if len(other_rows):
            t_ns, damaged = arrival(group.end_offset[other_rows])
            for row, t, damage in zip(other_rows.tolist(), t_ns.tolist(), damaged.tolist(), strict=True):
                node_others.append(OtherFrame(int(group.end_offset[row]), t, damage, group.frame_at(row)))
    frames_by_node = {}
    for node, node_others in others.items():
        node_others.sort(key=lambda one: one.end_offset)
        frames_by_node[node] = NodeFrames(node, _build_batches(batches.get(node, []), arrival), node_others)
    return frames_by_node


def _build_batches(groups: list[FrameGroup], arrival: ArrivalLookup) -> Batches:
    heads = [_read_headers(group) for group in groups]
    head = np.concatenate(heads) if heads else np.empty(0, _BATCH_HEADER)
    end = np.concatenate([group.end_offset for group in groups]) if groups else np.empty(0, np.int64)
    numbers = np.concatenate([group.seq for group in groups]) if groups else np.empty(0, np.uint16)
    rows = [_read_samples(group, some["count"]) for group, some in zip(groups, heads, strict=True)]
    samples = rows[0] if len(rows) == 1 else np.concatenate([np.empty((0, 6), np.int16), *rows])
    count = head["count"].astype(np.int64)
    first = np.cumsum(count) - count
    if len(groups) > 1:
        order = np.argsort(end, kind="stable")
        head, end, numbers, count, first_before_sort = (
            head[order],
            end[order],
            numbers[order],
            count[order],
            first[order],
        )
        first = np.cumsum(count) - count
        samples = samples[np.repeat(first_before_sort - first, count) + np.arange(len(samples))]
    t_ns, damaged = arrival(end)
    columns = {name: head[name].astype(np.int64) for name in _BATCH_HEADER.names or () if name != "count"}
    seq = numbers.astype(np.int64)
    steps_us = np.diff(columns["t_us"], prepend=columns["t_us"][:1]) % TICK_PERIOD_US
    follows, spaced, missing = _classify_steps(seq, t_ns, count, steps_us, columns)
    began_ns = 1000 * np.cumsum(steps_us)
    return Batches(
        end_offset=end,
        t_ns=t_ns,
        damaged=damaged,
        seq=seq,
        **columns,
        count=count,
        first_rows=first,
        rows=samples,
        is_contiguous=follows,
        has_counted_gap=spaced,
        missing_samples=missing,
        start_device_ns=began_ns,
        device_ns=_sample_times(began_ns, columns["period_ns"], count, first),
    )


def _read_headers(group: FrameGroup) -> NDArray[np.void]:
    return np.ascontiguousarray(group.payload[:, : _BATCH_HEADER.itemsize]).view(_BATCH_HEADER).reshape(-1)


def _read_samples(group: FrameGroup, count: NDArray[np.uint8]) -> NDArray[np.int16]:
    """Return the samples (N, 6) of batches with equal payload length; their sample counts may differ."""
    shape = payload_layout(ImuBatch)
    assert (
        shape.rows is not None
        and shape.rows.size == _SAMPLE_BYTES
        and shape.fixed.size == _BATCH_HEADER.itemsize
    )
    max_count = int(count.max())
    table = group.payload[:, _BATCH_HEADER.itemsize : _BATCH_HEADER.itemsize + max_count * _SAMPLE_BYTES]
    rows = np.ascontiguousarray(table).view("<i2").reshape(-1, max_count, 6)
    if bool((count == max_count).all()):
        return rows.reshape(-1, 6)
    return rows[np.arange(max_count) < count[:, None]]


def _sample_times(began_ns: Times, period_ns: Times, count: Times, first: Times) -> Times:
    """Return the device time (N,) of each sample, ns since the first batch."""
    max_count = int(count.max(initial=1))
    if bool((count == max_count).all()):
        return (began_ns[:, None] + period_ns[:, None] * np.arange(max_count)).reshape(-1)
    within = np.arange(int(count.sum())) - np.repeat(first, count)
    return np.repeat(began_ns, count) + np.repeat(period_ns, count) * within


def _classify_steps(
    seq: Times, t_ns: Times, count: Times, steps_us: Times, columns: Mapping[str, Times]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Times]:
    """Return is_contiguous, has_counted_gap and missing_samples of `Batches`.

    steps_us: (n,) advance of the node's clock since the previous batch.
    """
    follows, spaced = np.zeros(len(seq), bool), np.zeros(len(seq), bool)
    missing = np.zeros(len(seq), np.int64)
    if len(seq) < 2:
        return follows, spaced, missing
    period_ns, flags = columns["period_ns"], columns["flags"]
    step_us = steps_us[1:]
    late_us = step_us - np.diff(t_ns) // 1000
    missing[1:] = (np.diff(columns["index"]) - count[:-1]) % 0x10000
    gap_mismatch_ns = step_us * 1000 - (count * period_ns)[:-1] - missing[1:] * period_ns[1:]
    frames_lost = (np.diff(seq) - 1) % 0x10000
    is_continuous = (
        (flags[1:] & _DISCONTINUITY_FLAGS == 0)
        & (period_ns[1:] > 0)
        & (period_ns[:-1] > 0)
        & (step_us > 0)
        & (np.abs(late_us) < MAX_CLOCK_STEP_US)
        & (np.abs(gap_mismatch_ns) < _MAX_GAP_SAMPLES * period_ns[1:])
    )
    follows[1:] = is_continuous & (frames_lost == 0) & (missing[1:] == 0)
    spaced[1:] = is_continuous & (frames_lost > 0) & (frames_lost < 0x8000)
    return follows, spaced, missing
