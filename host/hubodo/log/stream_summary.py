"""Summary of one topic of a log: measured rate, jitter and gaps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.log import ros2
from hubodo.log.decode import normalise_type_name
from hubodo.log.gap_causes import explain_gap
from hubodo.recording import Event

GAP_FACTOR = 1.5
"""An interval longer than this many median periods is a gap: at least one sample is missing."""
_ODOMETRY_GAP_FACTOR = 2.5
"""Gap factor for odometry, whose poses come at the uneven times of two nodes' samples."""
_OCCASIONAL_TYPES = {ros2.TEMPERATURE, ros2.BATTERY}
"""Types sent occasionally: a period is reported, but no gaps."""
_SAMPLED_TYPES = (ros2.STAMPED_TYPES - _OCCASIONAL_TYPES) | {ros2.FLOAT64_ARRAY}


@dataclass(frozen=True)
class SampleGap:
    """An interval without samples. t: s since t = 0; missing: expected samples in it; cause: description."""

    topic: str
    t: float
    duration: float
    missing: int
    cause: str


@dataclass(frozen=True)
class StreamSummary:
    """One topic; times in s, from the header stamp if there is one, else the publish time.

    Attributes
    ----------
    first, last : times of the first and last message, since t = 0.
    period : median interval; jitter: its 1 sigma, without gaps; longest: longest interval.
    """

    topic: str
    schema: str
    messages: int
    first: float
    last: float
    period: float | None
    jitter: float | None
    longest: float | None
    gaps: tuple[SampleGap, ...]

    @property
    def rate(self) -> float | None:
        """1 / median period, Hz."""
        return 1 / self.period if self.period else None

    @property
    def missing(self) -> int:
        """Expected samples in the gaps."""
        return sum(gap.missing for gap in self.gaps)


def summarise_stream(
    topic: str, schema: str, publish_ns: NDArray[np.int64], start: int, events: Iterable[Event]
) -> StreamSummary:
    """Summarise the messages of a topic.

    publish_ns: (N,) their times, host time. start: host time of t = 0, ns. events: of the log, for the causes
    of gaps.
    """
    t_ns = np.sort(publish_ns)
    periods = np.diff(t_ns) / 1e9
    # Events and raw frames are irregular; only sampled streams have a period.
    factor = _ODOMETRY_GAP_FACTOR if normalise_type_name(schema) == ros2.ODOMETRY else GAP_FACTOR
    sampled = normalise_type_name(schema) in _SAMPLED_TYPES | _OCCASIONAL_TYPES
    period = float(np.median(periods)) if len(periods) and sampled else None
    regular = periods[periods <= factor * period] if period is not None else periods
    gaps: tuple[SampleGap, ...] = ()
    if period and normalise_type_name(schema) in _SAMPLED_TYPES:
        gap_rows = np.flatnonzero(periods > factor * period)
        gaps = tuple(
            SampleGap(
                topic,
                (int(t_ns[i]) - start) / 1e9,
                float(periods[i]),
                max(1, round(float(periods[i]) / period) - 1),
                explain_gap(topic, int(t_ns[i]), int(t_ns[i + 1]), events),
            )
            for i in gap_rows.tolist()
        )
    return StreamSummary(
        topic=topic,
        schema=schema,
        messages=len(t_ns),
        first=(int(t_ns[0]) - start) / 1e9,
        last=(int(t_ns[-1]) - start) / 1e9,
        period=period,
        jitter=float(np.sqrt(np.mean((regular - period) ** 2))) if period is not None else None,
        longest=float(periods.max()) if period is not None else None,
        gaps=gaps,
    )
