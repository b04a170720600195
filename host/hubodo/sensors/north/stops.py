"""One continuous recording on a turntable cut into stops, without the transients of the turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError

MIN_CUT_S = 0.2
"""Cut at both ends of each stop at least: clocks of table and node agree no better without more effort."""
MAX_CUT_S = 5.0
_BIN_S = 0.1
_PROBE = 5.0
ANGLE_TOLERANCE = np.radians(0.1)
MOVED_SIGMA = 8.0
MOVED_ANGLE = np.radians(0.5)
NOISY = 4.0
"""Times the median noise of a stop: something shook the table."""


@dataclass(frozen=True)
class TableMotion:
    """What the turntable did: t (K,) s, angle (K,) rad anticlockwise seen from above, moving (K,) bool.

    A row holds until the next; while the table moves, the angle runs evenly from row to row. Where the gyro
    felt the angles itself, scale_sigma is 1 sigma of their common relative error and turn_sigma, rad, what
    each turn adds; both are 0 for angles that are exact.
    """

    t: Array
    angle: Array
    moving: NDArray[np.bool_]
    scale_sigma: float = 0.0
    turn_sigma: float = 0.0

    def angle_at(self, t: Array) -> Array:
        """(N,) rad at any time."""
        angle = self.angle
        if len(angle) and float(np.abs(angle).max()) <= 2 * np.pi + 1e-9:
            angle = np.unwrap(angle)
        return np.asarray(np.interp(t, self.t, angle))


@dataclass(frozen=True)
class Stops:
    """S stops.

    start, end: (S,) first sample and one past the last. t: (S, 2) s. angle: (S,) rad. mean: (S,) rad/s. cut:
    (2,) s that were taken off the beginning and the end of every stop. scale_sigma, turn_sigma: of the
    angles, as in `TableMotion`. notes: what was left out, one line each.
    """

    start: NDArray[np.int64]
    end: NDArray[np.int64]
    t: Array
    angle: Array
    mean: Array
    cut: tuple[float, float]
    scale_sigma: float = 0.0
    turn_sigma: float = 0.0
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.start)

    @property
    def duration(self) -> float:
        """s of measurement in all stops together."""
        return float((self.t[:, 1] - self.t[:, 0]).sum())

    @property
    def turned(self) -> Array:
        """(S,) rad from the first stop."""
        return np.asarray(self.angle - self.angle[0])


def split_stops(
    t: Array, rate: Array, table: TableMotion, *, vertical: Array | None = None, settle: float | None = None
) -> Stops:
    """Cut the recording by the table's file.

    t: (N,) s. rate: (N,) rad/s of the axis used. vertical: (N,) rad/s upwards, to prove that the table stood
    still. settle: s to cut at both ends; None finds it from the transients. Raises InputError with the time
    when the table moved while it was said to be still, and when there is no stop.
    """
    spans = _still_spans(table)
    step = float(np.median(np.diff(t)))
    indices = [(int(np.searchsorted(t, a)), int(np.searchsorted(t, b)), angle) for a, b, angle in spans]
    indices = [(i, j, angle) for i, j, angle in indices if (j - i) * step > 4 * MIN_CUT_S and j - i > 8]
    if not indices:
        raise InputError(
            "table.csv and the node have no stop in common: moving is never 0 while the node records"
        )
    channels = [rate] if vertical is None else [rate, vertical]
    if settle is not None:
        cut = (settle, settle)
    else:
        cut = (_transient(channels, indices, step, 1), _transient(channels, indices, step, -1))
    first, last = (round(c / step) for c in cut)
    kept = [(i + first, j - last, angle) for i, j, angle in indices if j - i - first - last > 4]
    if not kept:
        raise InputError(
            f"nothing is left of any stop after cutting {cut[0]:.1f} and {cut[1]:.1f} s; make longer stops"
        )
    notes: list[str] = []
    if vertical is not None:
        _check_still(t, vertical, kept, step)
        kept, notes = _without_noisy(t, vertical, kept)
    starts, ends = (np.array([k[c] for k in kept]) for c in (0, 1))
    return Stops(
        starts,
        ends,
        np.column_stack([t[starts], t[ends - 1] + step]),
        np.array([k[2] for k in kept]),
        np.array([rate[i:j].mean() for i, j, _ in kept]),
        cut,
        table.scale_sigma,
        table.turn_sigma,
        tuple(notes),
    )


def _still_spans(table: TableMotion) -> list[tuple[float, float, float]]:
    """(from, to, angle) of each run of rows that are not moving."""
    spans = []
    edges = np.flatnonzero(np.diff(table.moving.astype(int))) + 1
    for rows in np.split(np.arange(len(table.t)), edges):
        if not len(rows) or table.moving[rows[0]]:
            continue
        angles = np.unwrap(table.angle[rows])
        spread = float(np.ptp(angles))
        if spread > ANGLE_TOLERANCE:
            at = table.t[rows[int(np.abs(np.diff(angles)).argmax()) + 1]]
            raise InputError(
                f"table.csv: the angle changes by {np.degrees(spread):.2f} degrees while moving is 0, near "
                f"t = {at:.2f} s; "
                "mark turns with moving = 1 or repeat the recording"
            )
        until = table.t[rows[-1] + 1] if rows[-1] + 1 < len(table.t) else np.inf
        spans.append((float(table.t[rows[0]]), float(until), float(angles.mean())))
    return spans


def _transient(
    channels: Sequence[Array], spans: Sequence[tuple[int, int, float]], step: float, direction: int
) -> float:
    """s to cut after (direction 1) or before (-1) a turn.

    Twice as long as the pooled mean square stands out.
    """
    # One stop cut short must not hide the transients of the others.
    usual = float(np.median([j - i for i, j, _ in spans]))
    spans = [span for span in spans if span[1] - span[0] > usual / 2]
    shortest = min(j - i for i, j, _ in spans)
    width = max(1, round(_BIN_S / step))
    probe = min(round(MAX_CUT_S / step), shortest // 4)
    bins = probe // width
    if bins < 1:
        return MIN_CUT_S
    last = -1
    for channel in channels:
        parts = np.array([channel[i:j][::direction][: 2 * probe] for i, j, _ in spans])
        reference = parts[:, probe:]
        sigma = np.sqrt(np.maximum(reference.var(axis=1, ddof=1), 1e-30) / width)
        means = parts[:, : bins * width].reshape(len(parts), bins, width).mean(axis=2)
        pooled = (((means - reference.mean(axis=1)[:, None]) / sigma[:, None]) ** 2).mean(axis=0)
        # Noise that is not quite white is the rule: the scatter of the calm part in bins sets the scale.
        calm = (
            reference[:, : (reference.shape[1] // width) * width].reshape(len(parts), -1, width).mean(axis=2)
        )
        level = float((((calm - calm.mean(axis=1)[:, None]) / sigma[:, None]) ** 2).mean())
        loud = np.flatnonzero(pooled > level * (1 + _PROBE * np.sqrt(2 / len(parts))))
        last = max(last, int(loud[-1]) if len(loud) else -1)
    # A tail too small to be seen still adds up, and its sign follows the table: cut as much again.
    return min(max(MIN_CUT_S, 2 * (last + 1) * width * step), probe * step)


def _check_still(t: Array, vertical: Array, spans: Sequence[tuple[int, int, float]], step: float) -> None:
    """The vertical gyro sees a table that turns: no stop may stand out in what it adds up to."""
    means = np.array([vertical[i:j].mean() for i, j, _ in spans])
    length = np.array([(j - i) * step for i, j, _ in spans])
    middle = np.median(means)
    scatter = 1.4826 * float(np.median(np.abs(means - middle)))
    swept = np.abs(means - middle) * length
    limit = np.maximum(MOVED_SIGMA * scatter * length, MOVED_ANGLE)
    for k in np.flatnonzero(swept > limit):
        i, j, _ = spans[int(k)]
        raise InputError(
            f"the table moved while it was said to be still: stop {k + 1}, {t[i]:.1f}..{t[j - 1]:.1f} s, the "
            f"vertical gyro adds up to {np.degrees(swept[k]):.1f} degrees; correct table.csv, or take stops "
            "and angles from the gyro with --find-stops"
        )


def _without_noisy(
    t: Array, vertical: Array, spans: Sequence[tuple[int, int, float]]
) -> tuple[list[tuple[int, int, float]], list[str]]:
    """The stops without those in which something shook the table, and a line for each of these."""
    noise = np.array([vertical[i:j].std() for i, j, _ in spans])
    ratio = noise / max(float(np.median(noise)), 1e-300)
    kept, notes = [], []
    for span, times in zip(spans, ratio, strict=True):
        if times > NOISY:
            i, j, _ = span
            notes.append(
                f"the stop at {t[i]:.1f}..{t[j - 1]:.1f} s is left out: {times:.1f} times the usual noise"
            )
        else:
            kept.append(span)
    return kept, notes
