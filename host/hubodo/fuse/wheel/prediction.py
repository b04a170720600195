"""What the windows show before anything is estimated: how still the vehicle is, and how hard it is driven."""

from __future__ import annotations

import cmath
import math

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import (
    EXCESS,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    WHEEL_ANGLE,
)
from hubodo.fuse.wheel.preintegration import WINDOW
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import Pairs


def least_still(pairs: Pairs, x: list[float], p: Array) -> Stillness:
    """The stillness of the wheel that is least still; x, p: states and covariance, for the biases."""
    found = Stillness.RESTING
    for wheel, window in pairs:
        at = wheel.at
        spin, bx, by = at[GYRO_BIAS_Z], at[GYRO_BIAS_X], at[GYRO_BIAS_Y]
        sigma = math.sqrt(max(p.item(spin, spin), p.item(bx, bx), p.item(by, by)))
        still = wheel.rest.stillness(window, x[spin], complex(x[bx], x[by]), sigma)
        if still < found:
            found = still
    return found


def forward_force(pairs: Pairs, x: list[float]) -> float | None:
    """Mean specific force, m/s², that accelerometers feel along the vehicle's forward axis.

    None where no accelerometer is usable.
    """
    total, count = 0.0, 0
    for wheel, window in pairs:
        if wheel.joined and window.missing == 0.0 and window.force_clipped == 0.0:
            at = wheel.at
            rate = window.spin / WINDOW
            if not window.all_clipped:
                rate = (rate - x[at[GYRO_BIAS_Z]]) / (1.0 + x[at[GYRO_SCALE_Z]])
            rate += x[at[EXCESS]]
            angle = x[at[WHEEL_ANGLE]] + 0.5 * rate * WINDOW
            total += (window.force * cmath.exp(1j * angle)).imag / WINDOW
            count += 1
    return total / count if count else None
