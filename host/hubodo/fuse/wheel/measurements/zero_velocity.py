"""Zero velocity: a vehicle that stands still has neither speed nor yaw rate.

    v = 0,  r = 0

The zero-velocity update of inertial navigation (Foxlin 2005): how still a vehicle is, its wheels tell.
"""

from collections.abc import Mapping

from hubodo.fuse.wheel.entries import SPEED, YAW_RATE, Entry
from hubodo.fuse.wheel.measurements.shared import Row
from hubodo.fuse.wheel.motion_state import MotionState

STATES = (SPEED, YAW_RATE)

_SIGMAS = {MotionState.STANDSTILL: (1e-3, 1e-4), MotionState.ROCKING: (0.03, 0.03)}
"""1 sigma of speed, m/s, and yaw rate, rad/s.

At rest: 0.1 mm and 0.6 mrad in a window, below what a gyro shows; rocked by hand: 3 cm back and forth within
a second. Estimated.
"""


def measure(x: list[float], at: Mapping[Entry, int], stillness: MotionState) -> tuple[Row, Row]:
    """Residuals in m/s and rad/s. Variance: how far a vehicle moves that is still or rocked about a place."""
    speed, yaw_rate = _SIGMAS[stillness]
    return (
        (-x[at[SPEED]], speed * speed, {SPEED: 1.0}),
        (-x[at[YAW_RATE]], yaw_rate * yaw_rate, {YAW_RATE: 1.0}),
    )
