"""Gaps of one node's streams: how much is missing, since when, and by which cause."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.recording import Event

RESTART = "node restarted"
LINK_DOWN = "link down"
OVERRUN = "chip overrun"
DAMAGE = "damaged bytes"
DROPPED = "node dropped frames"
ON_THE_WAY = "lost on the way"
ON_THE_AIR = "lost on the air"
STANDSTILL = "the computer stood still"

_HEALTHS_TO_WAIT = 2
_WAIT_NS = 6_000_000_000
_BACKLOG_NS = 1_000_000_000  # after a standstill, to read what the line has held
_STANDSTILL_NS = 3_000_000_000  # shorter silences are not due to a standstill, which lasts 5 s

Times = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LinkCounts:
    """What had happened on the link until a moment; two of them tell what happened between."""

    damaged: int = 0
    disconnections: int = 0


@dataclass(frozen=True, slots=True)
class WireGap:
    """Missing data of one stream.

    stream: message name; start_ns, end_ns: host times of the frames on both sides; frames_lost by
    sequence number; samples_lost by sample number, None where the count cannot be known. device_ns:
    device times of the last sample before and the first one behind, where the node went on counting.
    """

    stream: str
    start_ns: int
    end_ns: int
    frames_lost: int
    samples_lost: int | None
    device_ns: tuple[int, int] | None = None

    @property
    def duration_ns(self) -> int:
        """Length by the node's clock where that is known, else by the times of arrival."""
        first, last = self.device_ns or (self.start_ns, self.end_ns)
        return last - first


@dataclass(frozen=True, slots=True, eq=False)
class WireGaps:
    """Many gaps of a node's samples, (n,) each and as of `WireGap`; device_ns: (n, 2)."""

    start_ns: Times
    end_ns: Times
    frames_lost: Times
    samples_lost: Times
    device_ns: Times

    def __len__(self) -> int:
        return len(self.start_ns)

    def take(self, rows: NDArray[np.bool_] | slice) -> WireGaps:
        """Those of them."""
        columns = (self.start_ns, self.end_ns, self.frames_lost, self.samples_lost, self.device_ns)
        return WireGaps(*(column[rows] for column in columns))

    def __iter__(self) -> Iterator[WireGap]:
        times = zip(self.start_ns.tolist(), self.end_ns.tolist(), self.device_ns.tolist(), strict=True)
        lost = zip(self.frames_lost.tolist(), self.samples_lost.tolist(), strict=True)
        for (start_ns, end_ns, (last_ns, first_ns)), (frames, samples) in zip(times, lost, strict=True):
            yield WireGap("ImuBatch", start_ns, end_ns, frames, samples, (last_ns, first_ns))


@dataclass(frozen=True, slots=True, eq=False)
class GapsSeen:
    """Gaps of one cause."""

    node: str
    cause: str
    gaps: WireGaps

    def events(self) -> Iterator[Event]:
        """The event of each."""
        return (_event(self.node, gap, self.cause) for gap in self.gaps)


@dataclass(slots=True, eq=False)
class _Waiting:
    gaps: WireGaps | tuple[WireGap]
    healths: int = 0
    cause: str | None = None
    """The cause unless the computer stood still; None while the node's reports are to decide."""


class GapLedger:
    """Names the cause of each gap of one node.

    A gap that neither the link nor the node's flags explain waits for the node's own account: its
    second `Health` from then on has counted every frame given up before the gap was seen.
    """

    def __init__(self, node: str) -> None:
        self._node = node
        self._waiting: deque[_Waiting] = deque()
        self._dropped: int | None = None
        self._on_air: int | None = None
        self._standstill = (0, 0)  # host times of the newest one

    def add(
        self,
        gap: WireGap,
        before: LinkCounts,
        now: LinkCounts,
        *,
        overrun: bool = False,
        restart: bool = False,
    ) -> Iterator[Event]:
        """A gap has been seen; yields its event once the cause is plain."""
        if restart:
            yield _event(self._node, gap, RESTART)
        elif now.disconnections != before.disconnections:
            yield _event(self._node, gap, LINK_DOWN)
        elif now.damaged != before.damaged and gap.frames_lost:
            cause = f"{DAMAGE}, {OVERRUN}" if overrun else DAMAGE
            if gap.duration_ns < _STANDSTILL_NS:
                yield _event(self._node, gap, cause)
            else:
                # A line that runs over while the computer stands still cuts a frame in two.
                self._waiting.append(_Waiting((gap,), cause=cause))
        elif overrun:
            yield _event(self._node, gap, OVERRUN)
        else:
            self._waiting.append(_Waiting((gap,)))

    def add_many(self, gaps: WireGaps, before: Times, now: Times) -> Iterator[GapsSeen]:
        """Gaps with frames lost, none overrun; before, now: (n,) damaged pieces at the frames beside each."""
        damaged = now != before
        if damaged.any():
            yield GapsSeen(self._node, DAMAGE, gaps.take(damaged))
        if not damaged.all():
            self._waiting.append(_Waiting(gaps.take(~damaged)))

    def health(self, frames_dropped: int) -> Iterator[Event]:
        """The node's counter of frames it gave up."""
        grew = self._dropped is not None and frames_dropped > self._dropped
        grew = grew or (self._dropped is None and frames_dropped > 0)
        self._dropped = frames_dropped
        for waiting in list(self._waiting):
            waiting.healths += 1
            if grew:
                yield from self._settle(waiting, DROPPED)
            elif waiting.healths >= _HEALTHS_TO_WAIT:
                yield from self._settle(waiting, ON_THE_WAY)

    def radio(self, frames_lost: int) -> Iterator[Event]:
        """The counter of a receiver, of frames that did not come whole by radio."""
        grew = frames_lost > (self._on_air or 0)
        self._on_air = frames_lost
        if grew:
            for waiting in list(self._waiting):
                yield from self._settle(waiting, ON_THE_AIR)

    def resumed(self, begin_ns: int, end_ns: int) -> None:
        """The computer stood still between these host times: it is the cause of gaps that wait for one."""
        self._standstill = begin_ns, end_ns

    def restarted(self) -> None:
        """The node's counters have started anew."""
        self._dropped = 0

    def tick(self, now_ns: int) -> Iterator[Event]:
        """Names what has waited too long for a `Health`."""
        while self._waiting:
            first = self._waiting[0]
            if isinstance(first.gaps, WireGaps):
                young = np.flatnonzero(now_ns - first.gaps.end_ns <= _WAIT_NS)
                if len(young):
                    yield from (
                        _event(self._node, gap, ON_THE_WAY) for gap in first.gaps.take(slice(young[0]))
                    )
                    first.gaps = first.gaps.take(slice(young[0], None))
                    return
            elif now_ns - first.gaps[0].end_ns <= _WAIT_NS:
                return
            yield from self._settle(first, ON_THE_WAY)

    def close(self) -> Iterator[Event]:
        """Names all that still waits."""
        while self._waiting:
            yield from self._settle(self._waiting[0], ON_THE_WAY)

    def _settle(self, waiting: _Waiting, cause: str) -> Iterator[Event]:
        self._waiting.remove(waiting)
        begin_ns, end_ns = self._standstill
        for gap in waiting.gaps:
            stood_still = gap.start_ns < end_ns + _BACKLOG_NS and gap.end_ns > begin_ns
            yield _event(self._node, gap, STANDSTILL if stood_still else waiting.cause or cause)


def _event(node: str, gap: WireGap, cause: str) -> Event:
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
