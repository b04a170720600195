"""Segmentation of a continuous turntable recording into stops, without the transients of the turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.disturbances import find_disturbed_spans

MIN_STOP_CUT_S = 0.2
"""Minimum time cut at both ends of each stop, because the clocks of table and node agree only to that."""
MAX_STOP_CUT_S = 5.0
_TRANSIENT_BIN_S = 0.1
_TRANSIENT_SIGMA = 5.0
STANDSTILL_ANGLE_TOLERANCE = np.radians(0.1)
TABLE_MOTION_SIGMA = 8.0
TABLE_MOTION_ANGLE = np.radians(0.5)
BLOW_ANGLE = np.radians(1.0)
"""Rotation up to which a short deviation is a blow; the table may have turned by so much."""
MAX_STOP_NOISE_RATIO = 4.0
"""Noise of a stop, relative to the median, above which the table was disturbed."""


@dataclass(frozen=True)
class TableMotion:
    """The motion of a turntable.

    A row holds until the next one; while the table moves, the angle is interpolated linearly.

    Attributes:
        t: (K,) s.
        angle: (K,) anticlockwise seen from above, rad.
        moving: (K,) bool.
        scale_sigma, turn_sigma: if the gyro measured the angles, sigma of their common relative error, and
            sigma (rad) of the noise of each turn; 0 for exact angles.
    """

    t: Array
    angle: Array
    moving: NDArray[np.bool_]
    scale_sigma: float = 0.0
    turn_sigma: float = 0.0

    def angle_at(self, t: Array) -> Array:
        """Return the (N,) table angles, rad, at times t (N,) s."""
        angle = self.angle
        if len(angle) and float(np.abs(angle).max()) <= 2 * np.pi + 1e-9:
            angle = np.unwrap(angle)
        return np.asarray(np.interp(t, self.t, angle))

    def moving_at(self, t: Array) -> NDArray[np.bool_]:
        """Return (N,) True where the table moves at times t (N,) s."""
        row = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)
        return np.asarray(self.moving[row], bool)


@dataclass(frozen=True)
class Stops:
    """S stops of a turntable.

    Attributes:
        start, end: (S,) index of the first sample and one past the last.
        t: (S, 2) start and end, s.
        angle: (S,) rad.
        mean: (S,) mean rate, rad/s.
        cut: time cut at the beginning and at the end of every stop, s.
        scale_sigma, turn_sigma: sigmas of the angles, as in `TableMotion`.
        notes: one line for each stop excluded.
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
        """Return the total duration of all stops, s."""
        return float((self.t[:, 1] - self.t[:, 0]).sum())

    @property
    def angle_from_first(self) -> Array:
        """Return the (S,) angles relative to the first stop, rad."""
        return np.asarray(self.angle - self.angle[0])


def split_stops(
    t: Array, rate: Array, table: TableMotion, *, vertical: Array | None = None, settle: float | None = None
) -> Stops:
    """Cut a recording into stops by the motion of the table.

    t: (N,) s. rate: (N,) of the axis used, rad/s. vertical: (N,) rate about the vertical, rad/s, to check
    that the table was stationary. settle: time to cut at both ends, s; None estimates it from the
    transients. Raises InputError with the time if the table moved during a stop, and if there is no stop.
    """
    spans = stationary_spans(table)
    step = float(np.median(np.diff(t)))
    indices = [(int(np.searchsorted(t, a)), int(np.searchsorted(t, b)), angle) for a, b, angle in spans]
    indices = [(i, j, angle) for i, j, angle in indices if (j - i) * step > 4 * MIN_STOP_CUT_S and j - i > 8]
    if not indices:
        raise InputError(
            "table.csv and the node have no stop in common: moving is never 0 while the node records"
        )
    channels = [rate] if vertical is None else [rate, vertical]
    if settle is not None:
        cut = (settle, settle)
    else:
        cut = (_transient_time(channels, indices, step, 1), _transient_time(channels, indices, step, -1))
    first, last = (round(c / step) for c in cut)
    stops = [(i + first, j - last, angle) for i, j, angle in indices if j - i - first - last > 4]
    if not stops:
        raise InputError(
            f"all stops are shorter than the {cut[0]:.1f} and {cut[1]:.1f} s cut at their ends; make longer "
            "stops"
        )
    notes: list[str] = []
    nudge = 0.0
    if vertical is not None:
        stops, notes, nudge = _drop_disturbed(t, channels, vertical, stops, step)
        if not stops:
            raise InputError(f"every stop is excluded; {notes[0]}")
        _check_stationary(t, vertical, stops, step)
        stops, noisy = _drop_noisy(t, vertical, stops)
        notes += noisy
    starts, ends = (np.array([k[c] for k in stops]) for c in (0, 1))
    return Stops(
        starts,
        ends,
        np.column_stack([t[starts], t[ends - 1] + step]),
        np.array([k[2] for k in stops]),
        np.array([rate[i:j].mean() for i, j, _ in stops]),
        cut,
        table.scale_sigma,
        float(np.hypot(table.turn_sigma, nudge)),
        tuple(notes),
    )


def stationary_spans(table: TableMotion) -> list[tuple[float, float, float]]:
    """Return (start, end, angle) of each run of stationary rows.

    Raises InputError if the angle changes during a stop.
    """
    spans = []
    edges = np.flatnonzero(np.diff(table.moving.astype(int))) + 1
    for rows in np.split(np.arange(len(table.t)), edges):
        if not len(rows) or table.moving[rows[0]]:
            continue
        angles = np.unwrap(table.angle[rows])
        angle_range = float(np.ptp(angles))
        if angle_range > STANDSTILL_ANGLE_TOLERANCE:
            time = table.t[rows[int(np.abs(np.diff(angles)).argmax()) + 1]]
            raise InputError(
                f"table.csv: the angle changes by {np.degrees(angle_range):.2f} degrees while moving is 0, "
                f"near t = {time:.2f} s; mark turns with moving = 1 or repeat the recording"
            )
        end_time = table.t[rows[-1] + 1] if rows[-1] + 1 < len(table.t) else np.inf
        spans.append((float(table.t[rows[0]]), float(end_time), float(angles.mean())))
    return spans


def _transient_time(
    channels: Sequence[Array], spans: Sequence[tuple[int, int, float]], step: float, direction: int
) -> float:
    """Return the time to cut, s, after (direction 1) or before (-1) a turn.

    It is twice the time in which the pooled mean square is significantly above that of the calm part.
    """
    # A single short stop must not limit the length available for the others.
    median_samples = float(np.median([j - i for i, j, _ in spans]))
    spans = [span for span in spans if span[1] - span[0] > median_samples / 2]
    shortest = min(j - i for i, j, _ in spans)
    width = max(1, round(_TRANSIENT_BIN_S / step))
    probe_samples = min(round(MAX_STOP_CUT_S / step), shortest // 4)
    bins = probe_samples // width
    if bins < 1:
        return MIN_STOP_CUT_S
    last = -1
    for channel in channels:
        parts = np.array([channel[i:j][::direction][: 2 * probe_samples] for i, j, _ in spans])
        reference = parts[:, probe_samples:]
        sigma = np.sqrt(np.maximum(reference.var(axis=1, ddof=1), 1e-30) / width)
        means = parts[:, : bins * width].reshape(len(parts), bins, width).mean(axis=2)
        pooled = (((means - reference.mean(axis=1)[:, None]) / sigma[:, None]) ** 2).mean(axis=0)
        # The noise is rarely exactly white, so the binned calm part defines the reference level.
        calm_means = (
            reference[:, : (reference.shape[1] // width) * width].reshape(len(parts), -1, width).mean(axis=2)
        )
        level = float((((calm_means - calm_means.mean(axis=1)[:, None]) / sigma[:, None]) ** 2).mean())
        significant = np.flatnonzero(pooled > level * (1 + _TRANSIENT_SIGMA * np.sqrt(2 / len(parts))))
        last = max(last, int(significant[-1]) if len(significant) else -1)
    # Twice the detected time is cut: the undetected tail is a systematic error, as its sign follows the
    # table's motion.
    return min(max(MIN_STOP_CUT_S, 2 * (last + 1) * width * step), probe_samples * step)


def _check_stationary(
    t: Array, vertical: Array, spans: Sequence[tuple[int, int, float]], step: float
) -> None:
    """Raise InputError if the integrated vertical rate of a stop deviates significantly from the others."""
    means = np.array([vertical[i:j].mean() for i, j, _ in spans])
    length = np.array([(j - i) * step for i, j, _ in spans])
    median = np.median(means)
    scatter = 1.4826 * float(np.median(np.abs(means - median)))
    swept_angle = np.abs(means - median) * length
    limit = np.maximum(TABLE_MOTION_SIGMA * scatter * length, TABLE_MOTION_ANGLE)
    for k in np.flatnonzero(swept_angle > limit):
        i, j, _ = spans[int(k)]
        raise InputError(
            f"the table moved during stop {k + 1}, {t[i]:.1f}..{t[j - 1]:.1f} s: the integrated vertical "
            f"rate is {np.degrees(swept_angle[k]):.1f} degrees; correct table.csv, or derive stops and "
            "angles from the gyro with --find-stops"
        )


def _drop_disturbed(
    t: Array,
    channels: Sequence[Array],
    vertical: Array,
    spans: Sequence[tuple[int, int, float]],
    step: float,
) -> tuple[list[tuple[int, int, float]], list[str], float]:
    """Return the stops without blows to the node, a line for each other stop, and the angle turned by blows.

    The angle, rad, is the largest by which a blow turned the table; more than BLOW_ANGLE is motion, which
    `_check_stationary` reports.
    """
    disturbed: dict[int, str] = {}
    nudge = 0.0
    for k, a, b, size in find_disturbed_spans(channels, [(i, j) for i, j, _ in spans], step):
        i, j, _ = spans[k]
        turned = abs(float((vertical[a:b] - np.median(vertical[i:j])).sum())) * step
        if turned > BLOW_ANGLE:
            continue
        nudge = max(nudge, turned)
        disturbed[k] = (
            f"the stop at {t[i]:.1f}..{t[j - 1]:.1f} s is excluded: a blow at {t[a]:.1f}..{t[b - 1]:.1f} s, "
            f"{size:.0f} times the usual noise"
        )
    return [span for k, span in enumerate(spans) if k not in disturbed], list(disturbed.values()), nudge


def _drop_noisy(
    t: Array, vertical: Array, spans: Sequence[tuple[int, int, float]]
) -> tuple[list[tuple[int, int, float]], list[str]]:
    """Return the stops in which the table was undisturbed, and a line for each other stop."""
    noise = np.array([vertical[i:j].std() for i, j, _ in spans])
    noise_ratios = noise / max(float(np.median(noise)), 1e-300)
    stops, notes = [], []
    for span, noise_ratio in zip(spans, noise_ratios, strict=True):
        if noise_ratio > MAX_STOP_NOISE_RATIO:
            i, j, _ = span
            notes.append(
                f"the stop at {t[i]:.1f}..{t[j - 1]:.1f} s is excluded: {noise_ratio:.1f} times the usual "
                "noise"
            )
        else:
            stops.append(span)
    return stops, notes
