"""One window of a node: integrals over 0.1 s that are independent of all estimates, and its samples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array

WINDOW_S = 0.1
"""Length of a window, s.

At 2000 deg/s half a turn; an error of 1 % in spin rotates the ends of a window by 2 mrad/(rad/s).
"""

WINDOWS_PER_SECOND = round(1.0 / WINDOW_S)
"""Windows in a second: longer than a bump, than the pause of a wheel that reverses and than the delay of a
radio, and shorter than a manoeuvre. Estimated.
"""

_FULL_SHARE = 1.0 - 1e-9
"""Share of a window from which on all of it is clipped, but for rounding."""


class WindowSamples(NamedTuple):
    """The samples of one window and their neighbours outside it.

    They are stored if the gyro was clipped, so that the integrals of the window can be recomputed.

    Attributes
    ----------
    weight : s; the sum of weight times value is the integral over the window (trapezoidal rule).
    time : s from the middle of the window.
    rate : rad/s about the axle.
    angle : rad, integral of the rate from the middle of the window in angle.
    across : rad/s, gx + i gy.
    force : m/s², ax + i ay.
    x_in_range, y_in_range : False where ax, ay is saturated.
    """

    weight: tuple[float, ...]
    time: tuple[float, ...]
    rate: tuple[float, ...]
    angle: tuple[float, ...]
    across: tuple[complex, ...]
    force: tuple[complex, ...]
    x_in_range: tuple[bool, ...]
    y_in_range: tuple[bool, ...]


class Window(NamedTuple):
    """Integrals of one node over one window, transformed to face left.

    The carrier angle c(t) is the integral of the measured gz from the middle of the window in angle. Complex
    numbers are x + iy in node axes; T is the length of the window.

    Attributes
    ----------
    number : the window lies between start + number T and start + (number + 1) T.
    spin : rad, ∫ gz.
    rate_start, rate_end : rad/s, gz at the edges.
    across : rad, ∫ (gx + i gy) e^(ic).
    carrier : s, ∫ e^(ic).
    force : m/s, ∫ (ax + i ay) e^(ic).
    axial : m/s, ∫ az.
    raw_across, raw_force : ∫ (gx + i gy) and ∫ (ax + i ay), not derotated.
    gyro_variance : (rad/s)², variance within the window, sum of the three axes.
    axial_variance : (m/s²)², variance of az within the window.
    spin_clipped, across_clipped, force_clipped, axial_clipped : share of the time in which gz, gx or gy, ax
    or ay, az were saturated.
    missing : share of the time without samples.
    clock_angle : rad, carrier angle at the middle since the first sample.
    rate_carrier : rad, ∫ gz e^(ic).
    lever : rad/s, difference of i gz e^(ic) between the edges.
    across_change : rad/s, difference of (gx + i gy) e^(ic) between the edges.
    samples : the samples themselves if gz was clipped, else None.
    gravity_angle : rad, wheel angle at the middle of the window as gravity shows it in one axis of a
    saturated accelerometer, see `spin_search.py`; None where no axis was saturated or gravity was not found.
    blind_windows : consecutive windows, up to this one, in which gz and the accelerometers were saturated and
    nothing showed the spin.
    beyond_range : share of the time in which a second accelerometer replaced the IMU's, see
    `range_extension.py`.
    """

    number: int = 0
    spin: float = 0.0
    rate_start: float = 0.0
    rate_end: float = 0.0
    across: complex = 0j
    carrier: complex = 0j
    force: complex = 0j
    axial: float = 0.0
    raw_across: complex = 0j
    raw_force: complex = 0j
    gyro_variance: float = 0.0
    axial_variance: float = 0.0
    spin_clipped: float = 0.0
    across_clipped: float = 0.0
    force_clipped: float = 0.0
    axial_clipped: float = 0.0
    missing: float = 0.0
    clock_angle: float = 0.0
    rate_carrier: complex = 0.0
    lever: complex = 0j
    across_change: complex = 0j
    samples: WindowSamples | None = None
    gravity_angle: float | None = None
    blind_windows: int = 0
    beyond_range: float = 0.0

    def with_spin(self, spin: float) -> Window:
        """Return the window with another spin, in a quarter of the time of `_replace`."""
        return Window(self[0], spin, *self[2:])

    @property
    def any_clipped(self) -> bool:
        """Return True if any sensor was saturated for a part of the window."""
        return self.spin_clipped + self.across_clipped + self.force_clipped + self.axial_clipped > 0.0

    @property
    def all_clipped(self) -> bool:
        """Return True if gz was saturated all the time, so that its scale and bias are not observable."""
        return self.spin_clipped > _FULL_SHARE


EMPTY_WINDOW = Window(missing=1.0)
"""A window without any sample, too long a gap for interpolation."""


def slice_samples(t: Array, rows: Array, start: float, end: float, accel_limit: float) -> WindowSamples:
    """Return the samples between two times, s.

    rows: (6, N) gz, gx, gy in rad/s, ax, ay in m/s², and 1 where a second accelerometer replaced saturated
    values. accel_limit: m/s², from which on ax or ay is saturated otherwise.
    """
    first = max(0, int(np.searchsorted(t, start, side="right")) - 1)
    last = min(len(t), int(np.searchsorted(t, end, side="left")) + 1)
    t, rows = t[first:last], rows[:, first:last]
    step = np.diff(t)
    first_share = np.clip((start - t[:-1]) / step, 0.0, 1.0)
    last_share = np.clip((end - t[:-1]) / step, 0.0, 1.0)
    second_weight = 0.5 * (last_share * last_share - first_share * first_share)
    weight = np.zeros(len(t))
    weight[:-1] += step * (last_share - first_share - second_weight)
    weight[1:] += step * second_weight
    rate = rows[0]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[:-1] + rate[1:]) * step)])
    angle -= 0.5 * (_angle_at(start, t, rate, angle) + _angle_at(end, t, rate, angle))
    time = t - 0.5 * (start + end)
    across, force = rows[1] + 1j * rows[2], rows[3] + 1j * rows[4]
    columns = (
        weight,
        time,
        rate,
        angle,
        across,
        force,
        *((np.abs(rows[3:5]) < accel_limit) | (rows[5] > 0.0)),
    )
    return WindowSamples(*(tuple(column.tolist()) for column in columns))


def _angle_at(time: float, t: Array, rate: Array, angle: Array) -> float:
    index = min(max(int(np.searchsorted(t, time, side="right")) - 1, 0), len(t) - 2)
    step, elapsed = t[index + 1] - t[index], time - t[index]
    return float(
        angle[index] + elapsed * (rate[index] + 0.5 * elapsed / step * (rate[index + 1] - rate[index]))
    )
