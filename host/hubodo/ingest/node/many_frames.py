"""The frames of each node among many at once: its batches as arrays, the others one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.node.bulk import FrameGroup
from hubodo.ingest.node.clock import PERIOD_US
from hubowire import Frame
from hubowire.codec import layout
from hubowire.messages import BatchFlag, ImuBatch

Times = NDArray[np.int64]
Arrival = Callable[[Times], tuple[Times, Times]]
"""(n,) ends of frames in the stream -> (n,) host times of arrival, ns, and damaged pieces until then."""

_FIELDS = np.dtype(
    [
        ("t_us", "<u4"),
        ("period_ns", "<u4"),
        ("index", "<u2"),
        ("temperature_raw", "<i2"),
        ("flags", "u1"),
        ("count", "u1"),
    ]
)
_ROW = 12
STEP_US = 1_000_000
"""By how much the node's clock and ours may differ from one batch to the next."""
_PAUSE = 30_000  # samples: a pause from which on numbers modulo 2^16 would no longer tell what is lost
_OVERRUN = BatchFlag.GAP_BEFORE | BatchFlag.FIFO_OVERRUN | BatchFlag.RATE_CHANGED


@dataclass(frozen=True, slots=True, eq=False)
class Batches:
    """Sound batches of one node in the order they came, (n,) each; rows: (N, 6) int16, the samples of all.

    first: where the samples of each begin in rows. end, t_ns, damaged: see `Arrival`. follows: whether a
    batch goes on where the one before it ended, with nothing lost, flagged or out of time between them;
    spaced: the same, but frames are missing between them, and `missing` samples. began_ns, (n,): the node's
    time at each batch, and device_ns, (N,), at each sample, from the first batch on; both hold from one batch
    to the next where that follows or is spaced.
    """

    end: Times
    t_ns: Times
    damaged: Times
    seq: Times
    t_us: Times
    period_ns: Times
    index: Times
    temperature_raw: Times
    flags: Times
    count: Times
    first: Times
    rows: NDArray[np.int16]
    follows: NDArray[np.bool_]
    spaced: NDArray[np.bool_]
    missing: Times
    began_ns: Times
    device_ns: Times

    def __len__(self) -> int:
        return len(self.end)


@dataclass(frozen=True, slots=True)
class OtherFrame:
    """A frame that is no sound batch, with what `Arrival` says of it."""

    end: int
    t_ns: int
    damaged: int
    frame: Frame


@dataclass(slots=True)
class NodeFrames:
    """What came from one node: its sound batches, and all else in the order it came."""

    node: int
    batches: Batches
    others: list[OtherFrame] = field(default_factory=list)

    def batch(self, k: int) -> Frame:
        """Batch k as a frame."""
        some = self.batches
        head = np.zeros((), _FIELDS)
        for name in _FIELDS.names or ():
            head[name] = getattr(some, name)[k]
        rows = some.rows[some.first[k] : some.first[k] + some.count[k]]
        return Frame(ImuBatch.type_id, self.node, int(some.seq[k]), head.tobytes() + rows.tobytes())


def by_node(groups: Iterable[FrameGroup], arrival: Arrival) -> dict[int, NodeFrames]:
    """The frames of some groups by node, each node's in the order they came."""
    batches: dict[int, list[FrameGroup]] = {}
    others: dict[int, list[OtherFrame]] = {}
    for group in groups:
        rest = np.arange(len(group.seq))
        found = others.setdefault(group.node, [])
        if group.type_id == ImuBatch.type_id and group.payload.shape[1] >= _FIELDS.itemsize:
            # Byte 13 is the count of samples.
            count = group.payload[:, _FIELDS.itemsize - 1].astype(np.int64)
            sound = (count > 0) & (_FIELDS.itemsize + count * _ROW <= group.payload.shape[1])
            if sound.any():
                whole = group if sound.all() else group.take(np.flatnonzero(sound))
                batches.setdefault(group.node, []).append(whole)
            rest = np.flatnonzero(~sound)
        if len(rest):
            t_ns, damaged = arrival(group.end[rest])
            for row, t, damage in zip(rest.tolist(), t_ns.tolist(), damaged.tolist(), strict=True):
                found.append(OtherFrame(int(group.end[row]), t, damage, group.frame(row)))
    made = {}
    for node, several in others.items():
        several.sort(key=lambda one: one.end)
        made[node] = NodeFrames(node, _batches(batches.get(node, []), arrival), several)
    return made


def _batches(groups: list[FrameGroup], arrival: Arrival) -> Batches:
    heads = [_heads(group) for group in groups]
    head = np.concatenate(heads) if heads else np.empty(0, _FIELDS)
    end = np.concatenate([group.end for group in groups]) if groups else np.empty(0, np.int64)
    numbers = np.concatenate([group.seq for group in groups]) if groups else np.empty(0, np.uint16)
    rows = [_rows(group, some["count"]) for group, some in zip(groups, heads, strict=True)]
    samples = rows[0] if len(rows) == 1 else np.concatenate([np.empty((0, 6), np.int16), *rows])
    count = head["count"].astype(np.int64)
    first = np.cumsum(count) - count
    if len(groups) > 1:
        order = np.argsort(end, kind="stable")
        head, end, numbers, count, came = head[order], end[order], numbers[order], count[order], first[order]
        first = np.cumsum(count) - count
        samples = samples[np.repeat(came - first, count) + np.arange(len(samples))]
    t_ns, damaged = arrival(end)
    columns = {name: head[name].astype(np.int64) for name in _FIELDS.names or () if name != "count"}
    seq = numbers.astype(np.int64)
    steps_us = np.diff(columns["t_us"], prepend=columns["t_us"][:1]) % PERIOD_US
    follows, spaced, missing = _neighbours(seq, t_ns, count, steps_us, columns)
    began_ns = 1000 * np.cumsum(steps_us)
    return Batches(
        end=end,
        t_ns=t_ns,
        damaged=damaged,
        seq=seq,
        **columns,
        count=count,
        first=first,
        rows=samples,
        follows=follows,
        spaced=spaced,
        missing=missing,
        began_ns=began_ns,
        device_ns=_sample_times(began_ns, columns["period_ns"], count, first),
    )


def _heads(group: FrameGroup) -> NDArray[np.void]:
    return np.ascontiguousarray(group.payload[:, : _FIELDS.itemsize]).view(_FIELDS).reshape(-1)


def _rows(group: FrameGroup, count: NDArray[np.uint8]) -> NDArray[np.int16]:
    """The samples of batches of one length on the wire, (N, 6); their counts may differ."""
    shape = layout(ImuBatch)
    assert shape.rows is not None and shape.rows.size == _ROW and shape.fixed.size == _FIELDS.itemsize
    most = int(count.max())
    table = group.payload[:, _FIELDS.itemsize : _FIELDS.itemsize + most * _ROW]
    rows = np.ascontiguousarray(table).view("<i2").reshape(-1, most, 6)
    if bool((count == most).all()):
        return rows.reshape(-1, 6)
    return rows[np.arange(most) < count[:, None]]


def _sample_times(began_ns: Times, period_ns: Times, count: Times, first: Times) -> Times:
    """The node's time at each sample of batches of these counts, (N,)."""
    most = int(count.max(initial=1))
    if bool((count == most).all()):
        return (began_ns[:, None] + period_ns[:, None] * np.arange(most)).reshape(-1)
    within = np.arange(int(count.sum())) - np.repeat(first, count)
    return np.repeat(began_ns, count) + np.repeat(period_ns, count) * within


def _neighbours(
    seq: Times, t_ns: Times, count: Times, steps_us: Times, columns: Mapping[str, Times]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Times]:
    """follows, spaced and missing of `Batches`: what lies between each batch and the one before it.

    steps_us: what the node's clock went on by since the batch before.
    """
    follows, spaced = np.zeros(len(seq), bool), np.zeros(len(seq), bool)
    missing = np.zeros(len(seq), np.int64)
    if len(seq) < 2:
        return follows, spaced, missing
    period_ns, flags = columns["period_ns"], columns["flags"]
    step_us = steps_us[1:]
    late_us = step_us - np.diff(t_ns) // 1000
    missing[1:] = (np.diff(columns["index"]) - count[:-1]) % 0x10000
    beside_ns = step_us * 1000 - (count * period_ns)[:-1] - missing[1:] * period_ns[1:]
    frames_lost = (np.diff(seq) - 1) % 0x10000
    plain = (
        (flags[1:] & _OVERRUN == 0)
        & (period_ns[1:] > 0)
        & (period_ns[:-1] > 0)
        & (step_us > 0)
        & (np.abs(late_us) < STEP_US)
        & (np.abs(beside_ns) < _PAUSE * period_ns[1:])
    )
    follows[1:] = plain & (frames_lost == 0) & (missing[1:] == 0)
    spaced[1:] = plain & (frames_lost > 0) & (frames_lost < 0x8000)
    return follows, spaced, missing
