"""Strictly increasing log times over all nodes, and the rate of samples received."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

_RATE_WINDOW_NS = 2_000_000_000


class LogTimeSequence:
    """Log times of blocks of samples, strictly increasing over all nodes of a recorder.

    Sorted by log time, a log returns the blocks in the order in which the recorder processed them: the order
    of arrival, except for held samples and for links that were read at the same time.
    """

    def __init__(self) -> None:
        self._last_ns = 0

    def next_time(self, received_ns: int) -> int:
        """Return the log time of a block received at `received_ns`."""
        self._last_ns = max(received_ns, self._last_ns + 1)
        return self._last_ns

    def next_times(self, received_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the log times (B,) of consecutive blocks."""
        steps = np.arange(len(received_ns))
        level = received_ns - steps
        level[0] = max(int(level[0]), self._last_ns + 1)
        stamped: NDArray[np.int64] = np.maximum.accumulate(level) + steps
        self._last_ns = int(stamped[-1])
        return stamped


class RateWindow:
    """Mean sample rate over the last two seconds."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, int]] = deque()

    def add(self, t_ns: int, samples: int) -> None:
        """Add a number of samples received at `t_ns`."""
        self._recent.append((t_ns, samples))

    def rate(self, now_ns: int) -> float:
        """Return the sample rate, Hz."""
        while self._recent and self._recent[0][0] < now_ns - _RATE_WINDOW_NS:
            self._recent.popleft()
        return sum(count for _, count in self._recent) / (_RATE_WINDOW_NS / 1_000_000_000)
