"""Gaps in the streams of one node: extent, time and cause."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.recording import Event

NODE_RESTARTED = "node restarted"
LINK_DOWN = "link down"
CHIP_OVERRUN = "chip overrun"
DAMAGED_BYTES = "damaged bytes"
DROPPED_BY_NODE = "node dropped frames"
LOST_IN_TRANSIT = "lost on the way"
LOST_BY_RADIO = "lost on the air"
HOST_SUSPENDED = "the computer stood still"

_HEALTH_REPORTS_TO_WAIT = 2
_MAX_WAIT_NS = 6_000_000_000
_BACKLOG_NS = 1_000_000_000  # after a suspension, until the data buffered on the line is read
_MIN_SUSPENSION_GAP_NS = 3_000_000_000  # shorter gaps are not due to a suspension, which lasts 5 s or more

Times = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LinkCounts:
    """Counters of a link at one time; the difference of two shows what happened between."""

    damaged_frames: int = 0
    disconnections: int = 0


@dataclass(frozen=True, slots=True)
class WireGap:
    """A gap in one stream.

    Attributes
    ----------
    stream
        Message name.
    start_ns, end_ns
        Host times of the frames before and after the gap.
    frames_lost
        Number of frames by sequence number.
    samples_lost
        Number of samples by sample number; None where it cannot be known.
    device_ns
        Device times of the last sample before and the first after the gap; None across a restart.
    """

    stream: str
    start_ns: int
    end_ns: int
    frames_lost: int
    samples_lost: int | None
    device_ns: tuple[int, int] | None = None

    @property
    def duration_ns(self) -> int:
        """Duration by the node's clock where known, else by the times of arrival."""
        first, last = self.device_ns or (self.start_ns, self.end_ns)
        return last - first


@dataclass(frozen=True, slots=True, eq=False)
class WireGapArrays:
    """Gaps in a node's samples as arrays (n,) with the meaning of `WireGap`; device_ns: (n, 2)."""

    start_ns: Times
    end_ns: Times
    frames_lost: Times
    samples_lost: Times
    device_ns: Times

    def __len__(self) -> int:
        return len(self.start_ns)

    def select(self, rows: NDArray[np.bool_] | slice) -> WireGapArrays:
        """Return the gaps at these rows."""
        columns = (self.start_ns, self.end_ns, self.frames_lost, self.samples_lost, self.device_ns)
        return WireGapArrays(*(column[rows] for column in columns))

    def __iter__(self) -> Iterator[WireGap]:
        times = zip(self.start_ns.tolist(), self.end_ns.tolist(), self.device_ns.tolist(), strict=True)
        lost = zip(self.frames_lost.tolist(), self.samples_lost.tolist(), strict=True)
        for (start_ns, end_ns, (last_ns, first_ns)), (frames, samples) in zip(times, lost, strict=True):
            yield WireGap("ImuBatch", start_ns, end_ns, frames, samples, (last_ns, first_ns))


@dataclass(frozen=True, slots=True, eq=False)
class GapGroup:
    """Gaps of one node with the same cause."""

    node: str
    cause: str
    gaps: WireGapArrays

    def to_events(self) -> Iterator[Event]:
        """Return the event of each gap."""
        return (gap_event(self.node, gap, self.cause) for gap in self.gaps)


@dataclass(slots=True, eq=False)
class _PendingGaps:
    gaps: WireGapArrays | tuple[WireGap]
    health_reports: int = 0
    cause: str | None = None
    """Cause unless the host was suspended; None while the node's reports are to decide."""


class GapClassifier:
    """Assigns a cause to each gap of one node.

    A gap that neither the link nor the node's flags explain waits for the node's own counters: its second
    `Health` after the gap includes every frame dropped before the gap was detected.
    """

    def __init__(self, node: str) -> None:
        self._node = node
        self._pending: deque[_PendingGaps] = deque()
        self._frames_dropped: int | None = None
        self._radio_losses: int | None = None
        self._suspension_ns = (0, 0)  # start and end of the newest suspension of the host

    def add(
        self,
        gap: WireGap,
        before: LinkCounts,
        now: LinkCounts,
        *,
        overrun: bool = False,
        restart: bool = False,
    ) -> Iterator[Event]:
        """Add a gap and yield its event if the cause is already known."""
        if restart:
            yield gap_event(self._node, gap, NODE_RESTARTED)
        elif now.disconnections != before.disconnections:
            yield gap_event(self._node, gap, LINK_DOWN)
        elif now.damaged_frames != before.damaged_frames and gap.frames_lost:
            cause = f"{DAMAGED_BYTES}, {CHIP_OVERRUN}" if overrun else DAMAGED_BYTES
            if gap.duration_ns < _MIN_SUSPENSION_GAP_NS:
                yield gap_event(self._node, gap, cause)
            else:
                # A line that overflows during a suspension of the host cuts a frame in two.
                self._pending.append(_PendingGaps((gap,), cause=cause))
        elif overrun:
            yield gap_event(self._node, gap, CHIP_OVERRUN)
        else:
            self._pending.append(_PendingGaps((gap,)))

    def add_many(self, gaps: WireGapArrays, before: Times, now: Times) -> Iterator[GapGroup]:
        """Add gaps without overrun; before, now: (n,) damaged frames of the link before, after each gap."""
        damaged = now != before
        if damaged.any():
            yield GapGroup(self._node, DAMAGED_BYTES, gaps.select(damaged))
        if not damaged.all():
            self._pending.append(_PendingGaps(gaps.select(~damaged)))

    def update_dropped(self, frames_dropped: int) -> Iterator[Event]:
        """Update the node's counter of dropped frames and yield the events of gaps resolved by it."""
        has_grown = self._frames_dropped is not None and frames_dropped > self._frames_dropped
        has_grown = has_grown or (self._frames_dropped is None and frames_dropped > 0)
        self._frames_dropped = frames_dropped
        for waiting in list(self._pending):
            waiting.health_reports += 1
            if has_grown:
                yield from self._resolve(waiting, DROPPED_BY_NODE)
            elif waiting.health_reports >= _HEALTH_REPORTS_TO_WAIT:
                yield from self._resolve(waiting, LOST_IN_TRANSIT)

    def update_radio_losses(self, frames_lost: int) -> Iterator[Event]:
        """Update a radio receiver's counter of incomplete frames; yield the events of gaps resolved by it."""
        has_grown = frames_lost > (self._radio_losses or 0)
        self._radio_losses = frames_lost
        if has_grown:
            for waiting in list(self._pending):
                yield from self._resolve(waiting, LOST_BY_RADIO)

    def note_host_suspension(self, start_ns: int, end_ns: int) -> None:
        """Note a suspension of the host between these host times as the cause of pending gaps."""
        self._suspension_ns = start_ns, end_ns

    def note_restart(self) -> None:
        """Note that the node's counters were reset by a restart."""
        self._frames_dropped = 0

    def tick(self, now_ns: int) -> Iterator[Event]:
        """Resolve the gaps whose `Health` is overdue."""
        while self._pending:
            first = self._pending[0]
            if isinstance(first.gaps, WireGapArrays):
                young = np.flatnonzero(now_ns - first.gaps.end_ns <= _MAX_WAIT_NS)
                if len(young):
                    yield from (
                        gap_event(self._node, gap, LOST_IN_TRANSIT)
                        for gap in first.gaps.select(slice(young[0]))
                    )
                    first.gaps = first.gaps.select(slice(young[0], None))
                    return
            elif now_ns - first.gaps[0].end_ns <= _MAX_WAIT_NS:
                return
            yield from self._resolve(first, LOST_IN_TRANSIT)

    def close(self) -> Iterator[Event]:
        """Resolve all pending gaps."""
        while self._pending:
            yield from self._resolve(self._pending[0], LOST_IN_TRANSIT)

    def _resolve(self, waiting: _PendingGaps, cause: str) -> Iterator[Event]:
        self._pending.remove(waiting)
        begin_ns, end_ns = self._suspension_ns
        for gap in waiting.gaps:
            was_suspended = gap.start_ns < end_ns + _BACKLOG_NS and gap.end_ns > begin_ns
            yield gap_event(self._node, gap, HOST_SUSPENDED if was_suspended else waiting.cause or cause)


def gap_event(node: str, gap: WireGap, cause: str) -> Event:
    """Return the event of a gap."""
    seconds = gap.duration_ns * 1e-9
    if gap.stream == "ImuBatch":
        lost = "an unknown number of samples" if gap.samples_lost is None else f"{gap.samples_lost} samples"
    else:
        lost = f"{gap.frames_lost} {gap.stream} frames"
    return Event(
        t_ns=gap.start_ns,
        kind="gap",
        source=node,
        text=f"{node}: {lost} lost in {seconds:.3f} s: {cause}",
        data={
            "node": node,
            "stream": gap.stream,
            "samples_lost": gap.samples_lost,
            "frames_lost": gap.frames_lost,
            "cause": cause,
            "duration_s": seconds,
            "device_ns": list(gap.device_ns) if gap.device_ns else None,
        },
    )
