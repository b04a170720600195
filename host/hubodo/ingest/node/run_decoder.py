"""Decoder of many frames of a node at once, with contiguous batches decoded as one run."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator

import numpy as np

from hubodo.ingest.node.boot import BatchTail, BootState, StreamState
from hubodo.ingest.node.decoder import DecoderOutput, NodeDecoder
from hubodo.ingest.node.gaps import LinkCounts, WireGapArrays
from hubodo.ingest.node.node_frames import MAX_CLOCK_STEP_US, Batches, NodeFrames, Times
from hubodo.ingest.node.wire_batch import convert_to_si
from hubodo.log.records import ImuRun
from hubowire import Frame
from hubowire.messages import BatchFlag, Hello, ImuBatch


class RunDecoder(NodeDecoder):
    """A `NodeDecoder` that can also decode many frames at once."""

    def decode_many(self, frames: NodeFrames, disconnections: int) -> Iterator[DecoderOutput]:
        """Decode many frames; disconnections: number of losses of their link before.

        The outputs equal those of `decode_frame` for each frame bit by bit, except that contiguous batches
        are returned as one `ImuRun`, followed by the gaps between them as arrays.
        """
        batches, others = frames.batches, frames.others
        breaks = deque(np.flatnonzero(~(batches.is_contiguous | batches.has_counted_gap)).tolist())
        breaks.append(len(batches))
        edges = np.searchsorted(batches.end_offset, [other.end_offset for other in others]).tolist()
        edges.append(len(batches))
        start = next_new = 0
        for n, other in enumerate(others):
            next_new = max(next_new, n)
            while next_new < len(others) and self._is_repeated_hello(others[next_new].frame):
                next_new += 1
            start = yield from self._decode_batches(
                frames, start, edges[n], (edges[next_new], breaks), disconnections
            )
            yield from self.decode_frame(other.frame, other.t_ns, LinkCounts(other.damaged, disconnections))
        yield from self._decode_batches(frames, start, len(batches), (len(batches), breaks), disconnections)

    def _is_repeated_hello(self, frame: Frame) -> bool:
        """Return True if a frame repeats the newest Hello, which does not interrupt a run of batches."""
        return frame.type_id == Hello.type_id and frame.payload == self._hello_payload

    def _decode_batches(
        self, frames: NodeFrames, start: int, end: int, bounds: tuple[int, deque[int]], disconnections: int
    ) -> Generator[DecoderOutput, None, int]:
        """Decode at least batches start to end; return the index of the next batch.

        bounds: the last batch that a run may reach, and the indices of batches that do not continue the
        previous one.
        """
        batches, (reach, breaks) = frames.batches, bounds
        while start < end:
            while breaks[0] < start:
                breaks.popleft()
            stop = min(breaks[0], reach)
            boot = None if self._boot_is_unknown or self.mismatch_text is not None else self._boot
            if boot is not None and stop > start > 0 and _continues_boot(boot, batches, start):
                yield from self._decode_run(boot, batches, start, stop, disconnections)
                start = stop
                continue
            link = LinkCounts(int(batches.damaged[start]), disconnections)
            yield from self.decode_frame(frames.batch_frame(start), int(batches.t_ns[start]), link)
            start += 1
        return start

    def _decode_run(
        self, boot: BootState, batches: Batches, start: int, end: int, disconnections: int
    ) -> Iterator[DecoderOutput]:
        """Decode batches start to end at once, then report the gaps between them."""
        before = boot.tail
        assert before is not None
        before_ns = before.next_device_ns - before.period_ns
        run = _build_run(self.name, boot, batches, slice(start, end), disconnections)
        self.counts.frames += end - start
        self.counts.samples += len(run.device_ns)
        saturated = batches.flags[start:end] & BatchFlag.SATURATED
        self.counts.saturated_batches += int(np.count_nonzero(saturated))
        yield run
        after_gap = np.flatnonzero(batches.has_counted_gap[start:end])
        if len(after_gap):
            yield from self._report_gaps(
                batches, start + after_gap, run.device_ns, run.first_rows[after_gap], before_ns
            )

    def _report_gaps(
        self, batches: Batches, after_gap: Times, device_ns: Times, first_rows: Times, before_ns: int
    ) -> Iterator[DecoderOutput]:
        """Report the gaps before some batches of a run; first_rows: first sample of each of these batches."""
        last_ns = np.where(first_rows > 0, device_ns[first_rows - 1], before_ns)
        gaps = WireGapArrays(
            start_ns=batches.t_ns[after_gap - 1],
            end_ns=batches.t_ns[after_gap],
            frames_lost=(batches.seq[after_gap] - batches.seq[after_gap - 1] - 1) & 0xFFFF,
            samples_lost=batches.missing_samples[after_gap],
            device_ns=np.stack((last_ns, device_ns[first_rows]), axis=1),
        )
        self.counts.frames_lost += int(gaps.frames_lost.sum())
        self.counts.samples_lost += int(gaps.samples_lost.sum())
        self.counts.gaps += len(gaps)
        yield from self._gaps.add_many(gaps, batches.damaged[after_gap - 1], batches.damaged[after_gap])


def _continues_boot(boot: BootState, batches: Batches, start: int) -> bool:
    """Return True if a run may begin at batch `start`.

    That requires that the batch before it was the newest one decoded in this boot, and that the node's clock
    agrees with the host's.
    """
    stream, tail, before = boot.streams.get(ImuBatch.type_id), boot.tail, start - 1
    return (
        stream is not None
        and tail is not None
        and stream.seq == int(batches.seq[before])
        and tail.t_ns == int(batches.t_ns[before])
        and tail.next_index == int(batches.index[before] + batches.count[before]) & 0xFFFF
        and bool(boot.hello.gyro_lsb_ndps)
        and abs(boot.ticks.ticks_ahead(int(batches.t_us[start]), int(batches.t_ns[start])))
        < MAX_CLOCK_STEP_US
    )


def _build_run(node: str, boot: BootState, batches: Batches, run: slice, disconnections: int) -> ImuRun:
    """Return batches start to end, each continuing the previous one, as a run, and advance `boot`."""
    assert boot.tail is not None
    start, last, before = run.start, run.stop - 1, run.start - 1
    before_ns = boot.tail.next_device_ns - int(batches.count[before] * batches.period_ns[before])
    shift_ns = before_ns - int(batches.start_device_ns[before])
    count, period, t_ns = int(batches.count[last]), int(batches.period_ns[last]), int(batches.t_ns[last])
    last_us = (int(batches.start_device_ns[last]) + shift_ns) // 1000
    boot.ticks.unwrap(int(batches.t_us[last]), t_ns, last_us)
    link = LinkCounts(int(batches.damaged[last]), disconnections)
    boot.streams[ImuBatch.type_id] = StreamState(int(batches.seq[last]), t_ns, link)
    next_index = int(batches.index[last] + count) & 0xFFFF
    next_ns = int(batches.start_device_ns[last]) + shift_ns + count * period
    boot.tail = BatchTail(next_index, next_ns, period, t_ns)
    rows = slice(int(batches.first_rows[start]), int(batches.first_rows[last]) + count)
    hello = boot.hello
    gyro, accel = convert_to_si(batches.rows[rows], hello)
    steps = batches.temperature_raw[run] * hello.temperature_lsb_udegc + hello.temperature_offset_udegc
    return ImuRun(
        node=node,
        gyro=gyro,
        accel=accel,
        temperature=steps.astype(np.float64) * 1e-6,
        received_ns=batches.t_ns[run],
        device_ns=batches.device_ns[rows] + shift_ns,
        first_rows=batches.first_rows[run] - rows.start,
    )
