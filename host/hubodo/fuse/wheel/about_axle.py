"""What a tilted gyro feels of the vehicle's turning, taken out of the spin before any measurement sees it.

A node turned by the small vector m reads Omega - m x Omega, so gz = w_z - m_x w_y + m_y w_x. On a fast wheel
what is felt across the axle goes round many times in a curve, and the mean of it is nothing. On a slow one it
stays: 2 degrees of tilt in a curve of 0.6 rad/s are 0.02 rad/s of spin that the wheel does not make.
"""

from __future__ import annotations

from hubodo.fuse.wheel.entries import GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_X, MISALIGNMENT_Y
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.window import WINDOW, Window


def about_the_axle(x: list[float], wheel: Wheel, window: Window) -> Window:
    """The window with the spin about the axle, by the tilt as it is believed to be in the states x."""
    if not wheel.joined or window.missing > 0.0 or window.spin_clipped + window.across_clipped > 0.0:
        return window
    at, across = wheel.at, window.raw_across
    over_x, over_y = across.real - x[at[GYRO_BIAS_X]] * WINDOW, across.imag - x[at[GYRO_BIAS_Y]] * WINDOW
    felt = x[at[MISALIGNMENT_Y]] * over_x - x[at[MISALIGNMENT_X]] * over_y
    return window._replace(spin=window.spin - felt)
