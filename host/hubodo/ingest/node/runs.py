"""Many frames of a node at once: batches that go on from each other are taken together."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator

import numpy as np

from hubodo.ingest.node.boot import BatchTail, Boot, StreamPlace
from hubodo.ingest.node.decoder import NodeDecoder, Output
from hubodo.ingest.node.gaps import LinkCounts, WireGaps
from hubodo.ingest.node.many_frames import STEP_US, Batches, NodeFrames, Times
from hubodo.ingest.node.samples import ImuRun
from hubodo.ingest.node.wire_batch import in_si
from hubowire import Frame
from hubowire.messages import BatchFlag, Hello, ImuBatch


class RunDecoder(NodeDecoder):
    """A `NodeDecoder` that also takes many frames at once."""

    def many(self, some: NodeFrames, downs: int) -> Iterator[Output]:
        """The same for many frames at once, of which the link was lost so many times before.

        What they become is what `frame` gives for each, to the last bit; but batches that follow each other
        come as one `ImuRun`, and the gaps between them behind it as arrays.
        """
        batches, others = some.batches, some.others
        breaks = deque(np.flatnonzero(~(batches.follows | batches.spaced)).tolist())
        breaks.append(len(batches))
        edges = np.searchsorted(batches.end, [other.end for other in others]).tolist()
        edges.append(len(batches))
        at = news = 0
        for n, other in enumerate(others):
            news = max(news, n)
            while news < len(others) and self._says_nothing_new(others[news].frame):
                news += 1
            at = yield from self._batches(some, at, edges[n], (edges[news], breaks), downs)
            yield from self.frame(other.frame, other.t_ns, LinkCounts(other.damaged, downs))
        yield from self._batches(some, at, len(batches), (len(batches), breaks), downs)

    def _says_nothing_new(self, frame: Frame) -> bool:
        """Whether a frame is the newest Hello again: where nothing is in doubt, batches around it go on."""
        return frame.type_id == Hello.type_id and frame.payload == self._told

    def _batches(
        self, some: NodeFrames, at: int, end: int, bounds: tuple[int, deque[int]], downs: int
    ) -> Generator[Output, None, int]:
        """Batches at to end at least; returns where the next begins.

        bounds: up to where a run may reach, and the batches that do not go on from the one before them.
        """
        batches, (reach, breaks) = some.batches, bounds
        while at < end:
            while breaks[0] < at:
                breaks.popleft()
            stop = min(breaks[0], reach)
            boot = None if self._doubt or self.refusal is not None else self._boot
            if boot is not None and stop > at > 0 and _stands_before(boot, batches, at):
                yield from self._run(boot, batches, at, stop, downs)
                at = stop
                continue
            link = LinkCounts(int(batches.damaged[at]), downs)
            yield from self.frame(some.batch(at), int(batches.t_ns[at]), link)
            at += 1
        return at

    def _run(self, boot: Boot, batches: Batches, at: int, end: int, downs: int) -> Iterator[Output]:
        """Batches at to end at once, then the gaps between them."""
        before = boot.tail
        assert before is not None
        before_ns = before.next_device_ns - before.period_ns
        run = _take_run(boot, batches, at, end, downs)
        self.counts.frames += end - at
        self.counts.samples += len(run.device_ns)
        saturated = batches.flags[at:end] & BatchFlag.SATURATED
        self.counts.saturated_batches += int(np.count_nonzero(saturated))
        yield run
        spaced = np.flatnonzero(batches.spaced[at:end])
        if len(spaced):
            yield from self._missing(batches, at + spaced, run.device_ns, run.first[spaced], before_ns)

    def _missing(
        self, batches: Batches, behind: Times, device_ns: Times, first: Times, before_ns: int
    ) -> Iterator[Output]:
        """The gaps before some batches of a run; first: where those begin in its times."""
        last_ns = np.where(first > 0, device_ns[first - 1], before_ns)
        gaps = WireGaps(
            start_ns=batches.t_ns[behind - 1],
            end_ns=batches.t_ns[behind],
            frames_lost=(batches.seq[behind] - batches.seq[behind - 1] - 1) & 0xFFFF,
            samples_lost=batches.missing[behind],
            device_ns=np.stack((last_ns, device_ns[first]), axis=1),
        )
        self.counts.frames_lost += int(gaps.frames_lost.sum())
        self.counts.samples_lost += int(gaps.samples_lost.sum())
        self.counts.gaps += len(gaps)
        yield from self._gaps.add_many(gaps, batches.damaged[behind - 1], batches.damaged[behind])


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
    run, last, before = slice(at, end), end - 1, at - 1
    before_ns = boot.tail.next_device_ns - int(batches.count[before] * batches.period_ns[before])
    shift_ns = before_ns - int(batches.began_ns[before])
    count, period, t_ns = int(batches.count[last]), int(batches.period_ns[last]), int(batches.t_ns[last])
    last_us = (int(batches.began_ns[last]) + shift_ns) // 1000
    boot.ticks.unwrap(int(batches.t_us[last]), t_ns, last_us)
    link = LinkCounts(int(batches.damaged[last]), downs)
    boot.streams[ImuBatch.type_id] = StreamPlace(int(batches.seq[last]), t_ns, link)
    next_index = int(batches.index[last] + count) & 0xFFFF
    next_ns = int(batches.began_ns[last]) + shift_ns + count * period
    boot.tail = BatchTail(next_index, next_ns, period, t_ns)
    rows = slice(int(batches.first[at]), int(batches.first[last]) + count)
    raw, hello = batches.rows[rows], boot.hello
    gyro, accel = in_si(raw, hello)
    steps = batches.temperature_raw[run] * hello.temperature_lsb_udegc + hello.temperature_offset_udegc
    return ImuRun(
        device_ns=batches.device_ns[rows] + shift_ns,
        gyro=gyro,
        accel=accel,
        raw=raw,
        first=batches.first[run] - rows.start,
        temperature=steps.astype(np.float64) * 1e-6,
        received_ns=batches.t_ns[run],
    )
