"""Gaps of one node's streams: how much is missing, since when, and by which cause."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from hubodo.recording import Event

RESTART = "node restarted"
LINK_DOWN = "link down"
OVERRUN = "chip overrun"
DAMAGE = "damaged bytes"
DROPPED = "node dropped frames"
ON_THE_WAY = "lost on the way"
ON_THE_AIR = "lost on the air"

_HEALTHS_TO_WAIT = 2
_WAIT_NS = 6_000_000_000


@dataclass(frozen=True, slots=True)
class LinkCounts:
    """What had happened on the link until a moment; two of them tell what happened between."""

    damaged: int = 0
    downs: int = 0


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


@dataclass(slots=True)
class _Waiting:
    gap: WireGap
    healths: int = 0


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
            yield self._event(gap, RESTART)
        elif now.downs != before.downs:
            yield self._event(gap, LINK_DOWN)
        elif now.damaged != before.damaged and gap.frames_lost:
            yield self._event(gap, f"{DAMAGE}, {OVERRUN}" if overrun else DAMAGE)
        elif overrun:
            yield self._event(gap, OVERRUN)
        else:
            self._waiting.append(_Waiting(gap))

    def health(self, frames_dropped: int) -> Iterator[Event]:
        """The node's counter of frames it gave up."""
        grew = self._dropped is not None and frames_dropped > self._dropped
        grew = grew or (self._dropped is None and frames_dropped > 0)
        self._dropped = frames_dropped
        for waiting in list(self._waiting):
            waiting.healths += 1
            if grew:
                yield self._settle(waiting, DROPPED)
            elif waiting.healths >= _HEALTHS_TO_WAIT:
                yield self._settle(waiting, ON_THE_WAY)

    def radio(self, frames_lost: int) -> Iterator[Event]:
        """The counter of a receiver, of frames that did not come whole by radio."""
        grew = frames_lost > (self._on_air or 0)
        self._on_air = frames_lost
        if grew:
            for waiting in list(self._waiting):
                yield self._settle(waiting, ON_THE_AIR)

    def restarted(self) -> None:
        """The node's counters have started anew."""
        self._dropped = 0

    def tick(self, now_ns: int) -> Iterator[Event]:
        """Names what has waited too long for a `Health`."""
        while self._waiting and now_ns - self._waiting[0].gap.end_ns > _WAIT_NS:
            yield self._settle(self._waiting[0], ON_THE_WAY)

    def close(self) -> Iterator[Event]:
        """Names all that still waits."""
        while self._waiting:
            yield self._settle(self._waiting[0], ON_THE_WAY)

    def _settle(self, waiting: _Waiting, cause: str) -> Event:
        self._waiting.remove(waiting)
        return self._event(waiting.gap, cause)

    def _event(self, gap: WireGap, cause: str) -> Event:
        first, last = gap.device_ns or (gap.start_ns, gap.end_ns)
        seconds = (last - first) * 1e-9
        if gap.stream == "ImuBatch":
            lost = (
                "an unknown number of samples" if gap.samples_lost is None else f"{gap.samples_lost} samples"
            )
        else:
            lost = f"{gap.frames_lost} {gap.stream} frames"
        return Event(
            t_ns=gap.start_ns,
            kind="gap",
            source=self._node,
            text=f"{self._node}: {lost} lost in {seconds:.3f} s: {cause}",
            data={
                "node": self._node,
                "stream": gap.stream,
                "samples_lost": gap.samples_lost,
                "frames_lost": gap.frames_lost,
                "cause": cause,
                "duration_s": seconds,
                "device_ns": list(gap.device_ns) if gap.device_ns else None,
            },
        )
