"""Rate of a wheel about its axle, from the gyro corrected for bias, scale, saturation and tilt."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hubodo.fuse.wheel.entries import (
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    RATE_BEYOND_RANGE,
    Entry,
)
from hubodo.fuse.wheel.window import WINDOW_S, Window


class AxleRate(NamedTuple):
    """Rate about the axle, rad/s, and its derivatives by scale error and bias of the gyro."""

    rate: float
    scale_derivative: float
    bias_derivative: float


def correct_axle_rate(
    measured: float, is_saturated: bool, scale_error: float, bias: float, beyond: float
) -> AxleRate:
    """Return the rate about the axle: (measured - bias) / (1 + scale error) + rate beyond range, rad/s.

    A saturated gyro reports its limit, to which neither scale error nor bias applies.
    """
    if is_saturated:
        return AxleRate(measured + beyond, 0.0, 0.0)
    scale = 1.0 + scale_error
    in_range = (measured - bias) / scale
    return AxleRate(in_range + beyond, -in_range / scale, -1.0 / scale)


def mean_axle_rate(x: Sequence[float], columns: Mapping[Entry, int], window: Window) -> AxleRate:
    """Return the mean rate about the axle over a window, under the states x."""
    return correct_axle_rate(
        window.spin / WINDOW_S,
        window.all_clipped,
        x[columns[GYRO_SCALE_Z]],
        x[columns[GYRO_BIAS_Z]],
        x[columns[RATE_BEYOND_RANGE]],
    )


def remove_tilt_rate(x: Sequence[float], columns: Mapping[Entry, int], window: Window) -> Window:
    """Return the window with its spin projected onto the axle, for the tilt in the states x.

    A node rotated by the small vector m reads Ω - m x Ω, so gz = w_z - m_x w_y + m_y w_x. On a fast wheel the
    rates across the axle rotate many times within a curve and average out. On a slow one they do not: 2
    degrees of tilt in a curve of 0.6 rad/s add 0.02 rad/s. The spin is the rate along the axle
    n = (m_y, -m_x, √(1 - m_x² - m_y²)) in node axes.
    """
    if window.missing > 0.0 or window.spin_clipped + window.across_clipped > 0.0:
        return window
    across = window.raw_across
    over_x = across.real - x[columns[GYRO_BIAS_X]] * WINDOW_S
    over_y = across.imag - x[columns[GYRO_BIAS_Y]] * WINDOW_S
    tilt_x, tilt_y = x[columns[MISALIGNMENT_X]], x[columns[MISALIGNMENT_Y]]
    along = math.sqrt(max(0.0, 1.0 - tilt_x * tilt_x - tilt_y * tilt_y))
    return window.with_spin(along * window.spin - tilt_y * over_x + tilt_x * over_y)
