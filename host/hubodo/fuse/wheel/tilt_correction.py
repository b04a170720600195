"""Correction of the spin for the yaw rate that leaks into a tilted gyro.

A node rotated by the small vector m reads Ω - m x Ω, so gz = w_z - m_x w_y + m_y w_x. On a fast wheel the
rates across the axle rotate many times within a curve and average out. On a slow one they do not: 2 degrees
of tilt in a curve of 0.6 rad/s add 0.02 rad/s to the spin. The spin is the rate along the axle n = (m_y,
-m_x, √(1 - m_x² - m_y²)) in node axes.
"""

from __future__ import annotations

import math

from hubodo.fuse.wheel.entries import GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_X, MISALIGNMENT_Y
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.window import WINDOW_S, Window


def remove_tilt_rate(x: list[float], wheel: Wheel, window: Window) -> Window:
    """Return the window with its spin projected onto the axle, for the tilt in the states `x`."""
    if (
        not wheel.angle_initialised
        or window.missing > 0.0
        or window.spin_clipped + window.across_clipped > 0.0
    ):
        return window
    at, across = wheel.columns, window.raw_across
    over_x, over_y = across.real - x[at[GYRO_BIAS_X]] * WINDOW_S, across.imag - x[at[GYRO_BIAS_Y]] * WINDOW_S
    tilt_x, tilt_y = x[at[MISALIGNMENT_X]], x[at[MISALIGNMENT_Y]]
    upright = math.sqrt(max(0.0, 1.0 - tilt_x * tilt_x - tilt_y * tilt_y))
    return window._replace(spin=upright * window.spin - tilt_y * over_x + tilt_x * over_y)
