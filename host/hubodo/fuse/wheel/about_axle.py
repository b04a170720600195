"""What a tilted gyro feels of the vehicle's turning, taken out of the spin before any measurement sees it.

A node turned by the small vector m reads Omega - m x Omega, so gz = w_z - m_x w_y + m_y w_x. On a fast wheel
what is felt across the axle goes round many times in a curve, and the mean of it is nothing. On a slow one it
stays: 2 degrees of tilt in a curve of 0.6 rad/s are 0.02 rad/s of spin that the wheel does not make. The spin
is what there is along the axle, n = (m_y, -m_x, sqrt(1 - m_x^2 - m_y^2)) in the node's axes.
"""

from __future__ import annotations

import math

from hubodo.fuse.wheel.entries import GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_X, MISALIGNMENT_Y
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.window import WINDOW, Window


def about_the_axle(x: list[float], wheel: Wheel, window: Window) -> Window:
    """The window with the spin about the axle, by the tilt as it is believed to be in the states x."""
    if not wheel.joined or window.missing > 0.0 or window.spin_clipped + window.across_clipped > 0.0:
        return window
    at, across = wheel.at, window.raw_across
    over_x, over_y = across.real - x[at[GYRO_BIAS_X]] * WINDOW, across.imag - x[at[GYRO_BIAS_Y]] * WINDOW
    tilt_x, tilt_y = x[at[MISALIGNMENT_X]], x[at[MISALIGNMENT_Y]]
    upright = math.sqrt(max(0.0, 1.0 - tilt_x * tilt_x - tilt_y * tilt_y))
    return window._replace(spin=upright * window.spin - tilt_y * over_x + tilt_x * over_y)
