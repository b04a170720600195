"""Pose of the vehicle at the newest sample, extrapolated from the last pose by the wheels' last samples."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

from hubodo.fuse.wheel.axle_rate import correct_axle_rate
from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_Z,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    RATE_BEYOND_RANGE,
    TRACK_WIDTH,
    WHEEL_ANGLE,
    WHEEL_RADIUS,
    YAW_RATE_FROM_GRAVITY,
)
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.preintegration import WheelSample
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.vehicle import facing_sign


class SampleRates(NamedTuple):
    """Time, s, speed, m/s, and yaw rate, rad/s, from the last sample of a wheel."""

    t: float
    speed: float
    yaw_rate: float


class LiveExtrapolation:
    """The last pose and the last sample of each node.

    Attributes
    ----------
    pose : last pose; None before the first.
    """

    def __init__(self) -> None:
        self.pose: Pose | None = None
        self._samples: dict[str, WheelSample] = {}
        self._rates: dict[str, SampleRates] = {}

    def add(self, sample: WheelSample) -> None:
        """Add the newest sample of a node."""
        self._samples[sample.node] = sample
        self._rates.pop(sample.node, None)

    def start(self, pose: Pose) -> None:
        """Start from a new pose, whose states correct the rates of all samples."""
        self.pose = pose
        self._rates.clear()

    def state(self, core: FilterCore) -> Pose | None:
        """Return the pose at the newest sample with the covariance of the last one; None before the first."""
        pose = self.pose
        if pose is None:
            return None
        for wheel in core.wheels:
            sample = self._samples.get(wheel.name)
            if wheel.angle_initialised and sample is not None and wheel.name not in self._rates:
                self._rates[wheel.name] = rates_from_sample(core.x, wheel, sample, pose.t)
        rates = [it for it in self._rates.values() if it.t >= pose.t]
        t = max([pose.t, *(it.t for it in rates)])
        if not rates or pose.motion_state is not MotionState.MOVING:
            return pose._replace(t=t)
        speed = sum(it.speed for it in rates) / len(rates)
        yaw_rate = sum(it.yaw_rate for it in rates) / len(rates)
        dt = t - pose.t
        turn = 0.5 * (yaw_rate + pose.yaw_rate) * dt
        distance = 0.5 * (speed + pose.speed) * dt
        course = pose.heading + 0.5 * turn
        x, y = pose.x + distance * math.cos(course), pose.y + distance * math.sin(course)
        return pose._replace(t=t, x=x, y=y, heading=pose.heading + turn, speed=speed, yaw_rate=yaw_rate)


def rates_from_sample(x: Sequence[float], wheel: Wheel, sample: WheelSample, pose_t: float) -> SampleRates:
    """Return speed and yaw rate from a sample of a wheel, by `yaw.py` and `rolling.py`.

    x: states at the pose at time pose_t, s.
    """
    columns = wheel.columns
    sign = facing_sign(wheel.node.facing)
    measured = sign * sample.gyro[2]
    is_saturated = abs(measured) >= wheel.node.gyro_limit
    beyond = x[columns[RATE_BEYOND_RANGE]] if is_saturated else 0.0
    axle_rate = correct_axle_rate(
        measured, is_saturated, x[columns[GYRO_SCALE_Z]], x[columns[GYRO_BIAS_Z]], beyond
    ).rate
    camber = x[columns[CAMBER]]
    across = complex(sample.gyro[0], sign * sample.gyro[1])
    across -= complex(x[columns[GYRO_BIAS_X]], x[columns[GYRO_BIAS_Y]])
    across -= complex(-x[columns[MISALIGNMENT_Y]], x[columns[MISALIGNMENT_X]]) * axle_rate
    angle = x[columns[WHEEL_ANGLE]] + axle_rate * (sample.t - pose_t)
    upright = (across * cmath.exp(1j * angle)).real - x[columns[YAW_RATE_FROM_GRAVITY]]
    yaw_rate = upright / ((1.0 + x[columns[GYRO_SCALE_ACROSS]]) * math.cos(camber))
    yaw_rate -= wheel.geometry.ground_rate
    rolling_rate = axle_rate - wheel.geometry.side * yaw_rate * math.sin(camber)
    speed = wheel.geometry.radius * (1.0 + x[columns[WHEEL_RADIUS]]) * rolling_rate
    contact_y = wheel.geometry.contact_y * (1.0 + x[columns[TRACK_WIDTH]])
    return SampleRates(sample.t, speed + yaw_rate * contact_y, yaw_rate)
