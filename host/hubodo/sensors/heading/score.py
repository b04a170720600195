"""A heading beside the truth of the log: what it is off by, in degrees and in its own sigma."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.recording import Recording
from hubodo.sensors.heading.track import HeadingTrack
from hubodo.sensors.north.stops import TableMotion


@dataclass(frozen=True)
class TrueHeading:
    """source: the file. t: (K,) s. heading: (K,) rad, as the file counts it."""

    source: str
    t: Array
    heading: Array


@dataclass(frozen=True)
class HeadingError:
    """rad; (K,) error at each row of the truth that the track covers, zero at the first of them."""

    t: Array
    error: Array

    @property
    def rms(self) -> float:
        """rad."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def worst(self) -> float:
        """rad."""
        return float(np.abs(self.error).max())

    @property
    def end(self) -> float:
        """rad."""
        return float(self.error[-1])


@dataclass(frozen=True)
class HeadingScore:
    """errors: of the filter ("heading") and of its rivals. sigma: (K,) rad, what the filter says of its own.

    start: rad, the truth's heading where the track begins.
    """

    source: str
    start: float
    errors: dict[str, HeadingError]
    sigma: Array

    @property
    def end_in_sigma(self) -> float:
        """Error at the end over its sigma."""
        return self.errors["heading"].end / float(self.sigma[-1])


def truth_of(recording: Recording) -> TrueHeading | None:
    """The heading that `table.csv`, else `truth.csv`, else `heading.csv` tells; None where none does."""
    if recording.table is not None and len(recording.table) > 1:
        table = recording.table
        motion = TableMotion(table.t, table["angle"], table["moving"] > 0.5)
        return TrueHeading("table.csv", table.t, motion.angle_at(table.t))
    for name, told in (("truth.csv", recording.truth), ("heading.csv", recording.heading)):
        if told is None or "heading" not in told:
            continue
        known = np.isfinite(told["heading"])
        if np.count_nonzero(known) > 1:
            return TrueHeading(name, told.t[known], told["heading"][known])
    return None


def score(track: HeadingTrack, truth: TrueHeading) -> HeadingScore | None:
    """Errors where both have something to say; None where they have fewer than two rows in common."""
    inside = (truth.t >= track.t[0]) & (truth.t <= track.t[-1])
    if np.count_nonzero(inside) < 2:
        return None
    t, heading = truth.t[inside], truth.heading[inside]
    # Files count headings modulo a turn: the filter's own is near enough to say which turn is meant.
    ahead = np.interp(t, track.t, track.heading) - heading
    heading = heading + 2.0 * np.pi * np.round((ahead - ahead[0]) / (2.0 * np.pi))

    def against(values: Array) -> HeadingError:
        error = np.interp(t, track.t, values) - heading
        return HeadingError(t, error - error[0])

    errors = {"heading": against(track.heading)}
    errors |= {name: against(values) for name, values in track.rivals.items()}
    start = float(heading[0] - np.interp(t[0], track.t, track.heading))
    return HeadingScore(truth.source, start, errors, np.interp(t, track.t, track.sigma))
