"""The live state between two poses: extrapolation with the rates of the newest samples."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hubodo.fuse.wheel.config import WheelConfig, WheelNode
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
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.live_state import SampleRates, rates_from_sample
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.preintegration import WheelSample
from hubodo.fuse.wheel.records import Pose

R, TRACK, EARTH, LIMIT = 0.3, 0.6, 3e-3, 34.0
SPEED, YAW_RATE, LEAN, ANGLE = 1.7, 0.8, 0.15, 1.1
SAMPLE_DELAY = 0.04
"""Time from the pose to the sample, s."""

ERRORS = {
    GYRO_BIAS_X: 0.03,
    GYRO_BIAS_Y: -0.02,
    GYRO_BIAS_Z: 0.05,
    GYRO_SCALE_Z: 0.02,
    GYRO_SCALE_ACROSS: -0.03,
    MISALIGNMENT_X: 1e-4,
    MISALIGNMENT_Y: -2e-4,
    YAW_RATE_FROM_GRAVITY: 0.04,
    WHEEL_RADIUS: 0.01,
    TRACK_WIDTH: -0.02,
    CAMBER: LEAN,
}


def pose_with(motion_state: MotionState, speed: float = SPEED, yaw_rate: float = YAW_RATE) -> Pose:
    return Pose(5.0, 2.0, 3.0, 0.4, speed, yaw_rate, np.eye(5), motion_state, 0.0, 0)


def filter_with_pose(
    *sides: str, facing: str = "left", motion_state: MotionState = MotionState.MOVING
) -> WheelFilter:
    """Return a filter with a pose at 5 s whose wheels have the known errors ERRORS."""
    nodes = {side: WheelNode(side, facing, gyro_limit=LIMIT) for side in sides}  # type: ignore[arg-type]
    wheel_filter = WheelFilter(WheelConfig(R, TRACK, nodes, ground_rate=EARTH))
    wheel_filter._live.start(pose_with(motion_state))
    for wheel in wheel_filter.core.wheels:
        wheel.angle_initialised = True
        wheel_filter.core.x[wheel.columns[WHEEL_ANGLE]] = ANGLE
        for entry, value in ERRORS.items():
            wheel_filter.core.x[wheel.columns[entry]] = value
    return wheel_filter


def simulate_sample(
    wheel_filter: WheelFilter, side: str, speed: float = SPEED, yaw_rate: float = YAW_RATE
) -> WheelSample:
    """Return the sample of a node on a wheel of a vehicle in that motion, from a forward error model."""
    (wheel,) = [wheel for wheel in wheel_filter.core.wheels if wheel.name == side]
    sign = 1.0 if side == "left" else -1.0
    contact = 0.5 * sign * TRACK * (1.0 + ERRORS[TRACK_WIDTH])
    rolling_rate = (speed - yaw_rate * contact) / (R * (1.0 + ERRORS[WHEEL_RADIUS]))
    spin_rate = rolling_rate + sign * yaw_rate * math.sin(LEAN)
    angle = ANGLE + spin_rate * SAMPLE_DELAY
    rate_across = (1.0 + ERRORS[GYRO_SCALE_ACROSS]) * math.cos(LEAN) * (yaw_rate + EARTH) + ERRORS[
        YAW_RATE_FROM_GRAVITY
    ]
    # The vertical rate in axes of the node, which turn with the wheel.
    true_rates = np.array([rate_across * math.cos(angle), -rate_across * math.sin(angle), spin_rate])
    tilted_rates = (
        Rotation.from_rotvec([ERRORS[MISALIGNMENT_X], ERRORS[MISALIGNMENT_Y], 0.0]).inv().apply(true_rates)
    )
    reading = np.array([tilted_rates[0] + ERRORS[GYRO_BIAS_X], tilted_rates[1] + ERRORS[GYRO_BIAS_Y], 0.0])
    reading[2] = (1.0 + ERRORS[GYRO_SCALE_Z]) * spin_rate + ERRORS[GYRO_BIAS_Z]
    if wheel.node.facing == "right":
        reading[1:] = -reading[1:]
    return WheelSample(side, 5.0 + SAMPLE_DELAY, (reading[0], reading[1], reading[2]), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("facing", ["left", "right"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_rates_from_a_sample_are_corrected_for_the_errors_of_its_node(side: str, facing: str) -> None:
    wheel_filter = filter_with_pose(side, facing=facing)
    sample, core = simulate_sample(wheel_filter, side), wheel_filter.core
    rates = rates_from_sample(core.x, core.wheels[0], sample, 5.0)
    # The tilt is corrected to first order.
    assert rates == pytest.approx((5.0 + SAMPLE_DELAY, SPEED, YAW_RATE), abs=1e-4)


@pytest.mark.parametrize("facing", ["left", "right"])
def test_beyond_its_limit_a_gyro_is_corrected_by_the_excess_rate_alone(facing: str) -> None:
    wheel_filter = filter_with_pose("left", facing=facing)
    x, wheel = wheel_filter.core.x, wheel_filter.core.wheels[0]
    for entry in ERRORS:
        x[wheel.columns[entry]] = 0.0
    x[wheel.columns[GYRO_BIAS_Z]], x[wheel.columns[RATE_BEYOND_RANGE]] = 0.5, 12.0
    limit_reading = LIMIT if facing == "left" else -LIMIT
    sample = WheelSample("left", 5.0, (0.0, 0.0, limit_reading), (0.0, 0.0, 0.0))
    _, speed, yaw_rate = rates_from_sample(x, wheel, sample, 5.0)
    assert speed - yaw_rate * 0.5 * TRACK == pytest.approx(R * (LIMIT + 12.0))
    # Just below the limit, bias and scale are corrected and no excess rate is added.
    sample = WheelSample("left", 5.0, (0.0, 0.0, 0.999 * limit_reading), (0.0, 0.0, 0.0))
    _, speed, yaw_rate = rates_from_sample(x, wheel, sample, 5.0)
    assert speed - yaw_rate * 0.5 * TRACK == pytest.approx(R * (0.999 * LIMIT - 0.5))


def state_from_rates(wheel_filter: WheelFilter, **rates_by_side: tuple[float, float, float]) -> Any:
    """Return the live state for (time, speed, yaw rate) of the newest sample of each side."""
    wheel_filter._live._rates.update({side: SampleRates(*rates) for side, rates in rates_by_side.items()})
    return wheel_filter.state()


def test_the_state_follows_an_arc_at_the_mean_rates_of_both_wheels() -> None:
    """Speed and yaw rate change from 1.7 m/s and 0.8 rad/s to 2.1 m/s and 1.0 rad/s in 0.04 s."""
    state = state_from_rates(filter_with_pose("left", "right"), left=(5.02, 2.0, 0.9), right=(5.04, 2.2, 1.1))
    assert (state.t, state.speed, state.yaw_rate) == (5.04, pytest.approx(2.1), pytest.approx(1.0))
    heading = 0.4 + 0.9 * 0.04
    assert state.heading == pytest.approx(heading)
    radius = 1.9 / 0.9
    assert state.x == pytest.approx(2.0 + radius * (math.sin(heading) - math.sin(0.4)), abs=1e-5)
    assert state.y == pytest.approx(3.0 - radius * (math.cos(heading) - math.cos(0.4)), abs=1e-5)
    assert state.motion_state is MotionState.MOVING and np.array_equal(state.covariance, np.eye(5))


def test_samples_older_than_the_pose_are_ignored() -> None:
    state = state_from_rates(filter_with_pose("left", "right"), left=(4.99, 9.0, 9.0), right=(5.04, 2.1, 1.0))
    assert (state.t, state.speed, state.yaw_rate) == (5.04, 2.1, 1.0)
    state = state_from_rates(filter_with_pose("left", "right"), left=(4.99, 9.0, 9.0))
    assert (state.t, state.x, state.y, state.speed) == (5.0, 2.0, 3.0, SPEED)
    state = state_from_rates(filter_with_pose("left", "right"), left=(5.0, 2.1, 1.0))
    assert (state.t, state.x, state.y, state.speed) == (5.0, 2.0, 3.0, 2.1)


@pytest.mark.parametrize("motion_state", [MotionState.STANDSTILL, MotionState.ROCKING])
def test_at_standstill_only_the_time_of_the_state_advances(motion_state: MotionState) -> None:
    state = state_from_rates(
        filter_with_pose("left", "right", motion_state=motion_state),
        left=(5.02, 9.0, 9.0),
        right=(5.04, 9.0, 9.0),
    )
    assert (state.t, state.x, state.y, state.heading) == (5.04, 2.0, 3.0, 0.4)
    assert (state.speed, state.yaw_rate, state.motion_state) == (SPEED, YAW_RATE, motion_state)


def test_only_wheels_with_a_known_angle_contribute_rates() -> None:
    wheel_filter = filter_with_pose("left", "right")
    for side in ("left", "right"):
        wheel_filter._live.add(simulate_sample(wheel_filter, side))
    wheel_filter.core.wheels[1].angle_initialised = False
    assert wheel_filter.state() is not None and set(wheel_filter._live._rates) == {"left"}
    assert WheelFilter(wheel_filter.config).state() is None
