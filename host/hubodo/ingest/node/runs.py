"""Batches that follow each other without a gap: what the decoder does for each, for all at once."""

from __future__ import annotations

import numpy as np

from hubodo.ingest.node.boot import BatchTail, Boot, StreamPlace
from hubodo.ingest.node.clock import PERIOD_US
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.many_frames import STEP_US, Batches
from hubodo.ingest.node.samples import ImuRun
from hubodo.ingest.node.scale import RAD_PER_NANO_DEG, G
from hubowire.messages import ImuBatch


def goes_on(boot: Boot, batches: Batches, at: int) -> bool:
    """Whether batch `at`, which follows the one before it, can be taken with it in mind alone.

    So it is where that one was the last which this start of the node has given, and its clock is where the
    host's says it must be.
    """
    stream, tail, before = boot.streams.get(ImuBatch.type_id), boot.tail, at - 1
    return (
        stream is not None
        and tail is not None
        and stream.seq == int(batches.seq[before])
        and tail.t_ns == int(batches.t_ns[before])
        and tail.next_index == int(batches.index[before] + batches.count[before]) & 0xFFFF
        and bool(boot.hello.gyro_lsb_ndps)
        and abs(boot.ticks.ahead(int(batches.t_us[at]), int(batches.t_ns[at]))) < STEP_US
    )


def take_run(boot: Boot, batches: Batches, at: int, end: int, downs: int) -> ImuRun:
    """Batches at to end, each of which follows the one before; `boot` stands at the last of them then."""
    assert boot.tail is not None
    run, last = slice(at, end), end - 1
    count, period, t_us = batches.count[run], batches.period_ns[run], batches.t_us[run]
    before_ns = boot.tail.next_device_ns - int(batches.count[at - 1] * batches.period_ns[at - 1])
    steps_us = np.diff(t_us, prepend=batches.t_us[at - 1]) % PERIOD_US
    first_ns = before_ns + 1000 * np.cumsum(steps_us)
    t_ns = int(batches.t_ns[last])
    boot.ticks.unwrap(int(t_us[-1]), t_ns)
    link = LinkCounts(int(batches.damaged[last]), downs)
    boot.streams[ImuBatch.type_id] = StreamPlace(int(batches.seq[last]), t_ns, link)
    next_index = int(batches.index[last] + count[-1]) & 0xFFFF
    boot.tail = BatchTail(next_index, int(first_ns[-1] + count[-1] * period[-1]), int(period[-1]), t_ns)
    first = np.cumsum(count) - count
    total = int(count.sum())
    rows = batches.first[run]
    if bool((np.diff(rows) == count[:-1]).all()):
        raw = batches.rows[rows[0] : rows[0] + total]
    else:
        raw = batches.rows[np.repeat(rows - first, count) + np.arange(total)]
    within = np.arange(total) - np.repeat(first, count)
    hello = boot.hello
    steps = batches.temperature_raw[run] * hello.temperature_lsb_udegc + hello.temperature_offset_udegc
    return ImuRun(
        device_ns=np.repeat(first_ns, count) + np.repeat(period, count) * within,
        gyro=raw[:, :3].astype(np.float64) * (hello.gyro_lsb_ndps * RAD_PER_NANO_DEG),
        accel=raw[:, 3:].astype(np.float64) * (hello.accel_lsb_ng * 1e-9 * G),
        raw=raw,
        first=first,
        temperature=steps.astype(np.float64) * 1e-6,
        received_ns=batches.t_ns[run],
    )
