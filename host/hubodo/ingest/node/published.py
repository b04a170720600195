"""Samples of a node as they went into the log, and the order of their log times over all nodes."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.node.samples import ImuBlock

_RATE_WINDOW_NS = 2_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Published:
    """Samples of a node as they went into the log.

    t_ns: (N,) host time of measurement. power_on_ns: host time at which the node was switched on.
    supply: V, as the node last measured it before, None where it has not.
    """

    node: str
    t_ns: NDArray[np.int64]
    block: ImuBlock
    power_on_ns: int | None
    supply: float | None


class ArrivalOrder:
    """Log times of blocks of samples: strictly increasing over all nodes of a recorder.

    A log read by log time then gives the blocks in the order in which the recorder took them, which is that
    of arrival but for what was held back and for links that were read at the same moment.
    """

    def __init__(self) -> None:
        self._last_ns = 0

    def stamp(self, received_ns: int) -> int:
        """The log time of a block received at that time."""
        self._last_ns = max(received_ns, self._last_ns + 1)
        return self._last_ns

    def stamps(self, received_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """The same for blocks (B,) one after the other."""
        steps = np.arange(len(received_ns))
        level = received_ns - steps
        level[0] = max(int(level[0]), self._last_ns + 1)
        stamped: NDArray[np.int64] = np.maximum.accumulate(level) + steps
        self._last_ns = int(stamped[-1])
        return stamped


class RateWindow:
    """Samples a second over the last two seconds."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, int]] = deque()

    def add(self, t_ns: int, samples: int) -> None:
        """So many came at t_ns."""
        self._recent.append((t_ns, samples))

    def rate(self, now_ns: int) -> float:
        """Hz."""
        while self._recent and self._recent[0][0] < now_ns - _RATE_WINDOW_NS:
            self._recent.popleft()
        return sum(count for _, count in self._recent) / (_RATE_WINDOW_NS / 1_000_000_000)
