"""Many frames of a node at once: batches that go on from each other are taken together."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np

from hubodo.ingest.node.boot import BatchTail, Boot, StreamPlace
from hubodo.ingest.node.clock import PERIOD_US
from hubodo.ingest.node.decoder import NodeDecoder, Output
from hubodo.ingest.node.gaps import LinkCounts, WireGap
from hubodo.ingest.node.many_frames import STEP_US, Batches, NodeFrames
from hubodo.ingest.node.samples import ImuRun
from hubodo.ingest.node.scale import RAD_PER_NANO_DEG, G
from hubowire.messages import BatchFlag, ImuBatch


class RunDecoder(NodeDecoder):
    """A `NodeDecoder` that also takes many frames at once."""

    def many(self, some: NodeFrames, downs: int) -> Iterator[Output]:
        """The same for many frames at once, of which the link was lost so many times before.

        What they become is what `frame` gives for each, to the last bit; but batches that follow each other
        without a gap come as one `ImuRun`.
        """
        at = 0
        for other in some.others:
            end = int(np.searchsorted(some.batches.end, other.end))
            yield from self._batches(some, at, end, downs)
            yield from self.frame(other.frame, other.t_ns, LinkCounts(other.damaged, downs))
            at = end
        yield from self._batches(some, at, len(some.batches), downs)

    def _batches(self, some: NodeFrames, at: int, end: int, downs: int) -> Iterator[Output]:
        """Batches at to end, those that follow the one before as a run."""
        batches = some.batches
        goes_on = batches.follows[at:end] | batches.spaced[at:end]
        breaks = deque(np.append(at + np.flatnonzero(~goes_on), end).tolist())
        while at < end:
            while breaks[0] < at:
                breaks.popleft()
            stop = breaks[0]
            boot = None if self._doubt or self.refusal is not None else self._boot
            if boot is not None and stop > at > 0 and _stands_before(boot, batches, at):
                yield from self._run(boot, batches, at, stop, downs)
                at = stop
                continue
            link = LinkCounts(int(batches.damaged[at]), downs)
            yield from self.frame(some.batch(at), int(batches.t_ns[at]), link)
            at += 1

    def _run(self, boot: Boot, batches: Batches, at: int, end: int, downs: int) -> Iterator[Output]:
        """Batches at to end at once; where frames are missing between two, the gap stands between them."""
        before = boot.tail
        assert before is not None
        before_ns = before.next_device_ns - before.period_ns
        run = _take_run(boot, batches, at, end, downs)
        self.counts.frames += end - at
        self.counts.samples += len(run.device_ns)
        saturated = batches.flags[at:end] & BatchFlag.SATURATED
        self.counts.saturated_batches += int(np.count_nonzero(saturated))
        begin = 0
        for k in (at + np.flatnonzero(batches.spaced[at:end])).tolist():
            here = k - at
            if here > begin:
                yield run.part(begin, here)
                begin = here
            last_ns = int(run.device_ns[run.first[here] - 1]) if here else before_ns
            yield from self._missing(batches, k, (last_ns, int(run.device_ns[run.first[here]])), downs)
        yield run.part(begin, end - at)

    def _missing(self, batches: Batches, k: int, between: tuple[int, int], downs: int) -> Iterator[Output]:
        """The gap before batch k, between these device times."""
        frames, samples = int(batches.seq[k] - batches.seq[k - 1] - 1) & 0xFFFF, int(batches.missing[k])
        self.counts.frames_lost += frames
        self.counts.samples_lost += samples
        self.counts.gaps += 1
        start_ns, end_ns = batches.t_ns[k - 1 : k + 1].tolist()
        before, link = (LinkCounts(n, downs) for n in batches.damaged[k - 1 : k + 1].tolist())
        gap = WireGap("ImuBatch", start_ns, end_ns, frames, samples, between)
        yield from self._gaps.add(gap, before, link)


def _stands_before(boot: Boot, batches: Batches, at: int) -> bool:
    """Whether batch `at`, which goes on from the one before it, can be taken with that one in mind alone.

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


def _take_run(boot: Boot, batches: Batches, at: int, end: int, downs: int) -> ImuRun:
    """Batches at to end, each of which goes on from the one before; `boot` stands at the last then."""
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
