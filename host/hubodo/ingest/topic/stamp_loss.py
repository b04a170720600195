"""Estimate of the messages lost between two stamps of a topic."""

from __future__ import annotations

import statistics
from collections import deque

_INTERVALS, _MIN_INTERVALS = 127, 60
_GAP_RATIO = 1.6
"""Interval from which a message counts as lost, in usual intervals: few stamps are half an interval late."""
_USUAL_QUANTILE = 0.92
"""Quantile of the intervals that counts as usual. Drivers that stamp on arrival send up to ten samples at
once, so that one interval in ten is long; losses of more than 8 % of the messages are underestimated."""


class StampLoss:
    """Counts lost messages by the intervals between stamps, as DDS with best effort reports no losses."""

    def __init__(self) -> None:
        self._intervals: deque[int] = deque(maxlen=_INTERVALS)

    def add_interval(self, interval_ns: int) -> int:
        """Return the number of messages that are missing in an interval, 0 while the period is unknown."""
        lost, count = 0, len(self._intervals)
        if count >= _MIN_INTERVALS:
            period_ns = statistics.median(self._intervals)
            mean_ns = sum(self._intervals) / count
            if mean_ns > 2 * period_ns:  # samples are sent in batches
                period_ns = mean_ns
            if interval_ns > _GAP_RATIO * period_ns:
                usual_ns = sorted(self._intervals)[int(_USUAL_QUANTILE * count)]
                if interval_ns > _GAP_RATIO * usual_ns:
                    lost = round(interval_ns / period_ns) - 1
        self._intervals.append(interval_ns)
        return lost
