"""Zero velocity: a stationary vehicle has neither speed nor yaw rate.

    v = 0,  r = 0

Zero-velocity update of inertial navigation (Foxlin 2005).
"""

from collections.abc import Mapping

from hubodo.fuse.wheel.entries import SPEED, YAW_RATE, Entry
from hubodo.fuse.wheel.measurements.shared import Row
from hubodo.fuse.wheel.motion_state import MotionState

STATES = (SPEED, YAW_RATE)

_ZERO_VELOCITY_SIGMA = {MotionState.STANDSTILL: (1e-3, 1e-4), MotionState.ROCKING: (0.03, 0.03)}
"""1 sigma of speed, m/s, and yaw rate, rad/s.

Standstill: 0.1 mm and 0.01 mrad in a window, below the resolution of a gyro; rocking by hand: 3 cm to and
fro within a second. Estimated.
"""


def measure(x: list[float], columns: Mapping[Entry, int], motion_state: MotionState) -> tuple[Row, Row]:
    """Return the rows of speed (m/s) and yaw rate (rad/s) for a vehicle at standstill or rocking."""
    speed, yaw_rate = _ZERO_VELOCITY_SIGMA[motion_state]
    return (
        (-x[columns[SPEED]], speed * speed, {SPEED: 1.0}),
        (-x[columns[YAW_RATE]], yaw_rate * yaw_rate, {YAW_RATE: 1.0}),
    )
