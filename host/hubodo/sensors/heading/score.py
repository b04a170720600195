"""Errors of a heading against the truth in the log, in degrees and in sigmas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.recording import Recording
from hubodo.sensors.heading.track import HeadingTrack
from hubodo.sensors.north.stops import TableMotion


@dataclass(frozen=True)
class TrueHeading:
    """The true heading from file `source`: t (K,) s, heading (K,) rad with the file's zero."""

    source: str
    t: Array
    heading: Array


@dataclass(frozen=True)
class HeadingError:
    """The (K,) heading errors, rad, at the times t (K,) of the truth within the track.

    The first error is zero, because only changes of heading are compared.
    """

    t: Array
    error: Array

    @property
    def rms(self) -> float:
        """Return the root mean square error, rad."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def largest(self) -> float:
        """Return the largest absolute error, rad."""
        return float(np.abs(self.error).max())

    @property
    def final(self) -> float:
        """Return the error at the end, rad."""
        return float(self.error[-1])


@dataclass(frozen=True)
class HeadingScore:
    """The heading errors of one track.

    Attributes:
        source: file of the truth.
        start: true heading at the start of the track, rad.
        errors: errors of the filter ("heading") and of the baselines, by name.
        sigma: (K,) sigma of the filter, rad.
    """

    source: str
    start: float
    errors: dict[str, HeadingError]
    sigma: Array

    @property
    def final_error_in_sigma(self) -> float:
        """Return the error at the end divided by its sigma."""
        return self.errors["heading"].final / float(self.sigma[-1])


def read_true_heading(recording: Recording) -> TrueHeading | None:
    """Return the true heading of `table.csv`, else `truth.csv`, else `heading.csv`; None if there is none."""
    if recording.table is not None and len(recording.table) > 1:
        table = recording.table
        motion = TableMotion(table.t, table["angle"], table["moving"] > 0.5)
        return TrueHeading("table.csv", table.t, motion.angle_at(table.t))
    for name, source in (("truth.csv", recording.truth), ("heading.csv", recording.heading)):
        if source is None or "heading" not in source:
            continue
        finite = np.isfinite(source["heading"])
        if np.count_nonzero(finite) > 1:
            return TrueHeading(name, source.t[finite], source["heading"][finite])
    return None


def score_heading(track: HeadingTrack, truth: TrueHeading) -> HeadingScore | None:
    """Return the errors of a track where truth is available, or None for fewer than two common rows."""
    covered = (truth.t >= track.t[0]) & (truth.t <= track.t[-1])
    if np.count_nonzero(covered) < 2:
        return None
    t, heading = truth.t[covered], truth.heading[covered]
    # Headings in files are modulo full turns; the filter's heading resolves the number of turns.
    difference = np.interp(t, track.t, track.heading) - heading
    heading = heading + 2.0 * np.pi * np.round((difference - difference[0]) / (2.0 * np.pi))

    def baseline_error(values: Array) -> HeadingError:
        error = np.interp(t, track.t, values) - heading
        return HeadingError(t, error - error[0])

    errors = {"heading": baseline_error(track.heading)}
    errors |= {name: baseline_error(values) for name, values in track.baselines.items()}
    start = float(heading[0] - np.interp(t[0], track.t, track.heading))
    return HeadingScore(truth.source, start, errors, np.interp(t, track.t, track.sigma))
