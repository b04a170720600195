"""Where a vehicle is between two poses, by the last samples: the sensors of a wheel, turned round."""

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
from hubodo.fuse.wheel.filter import WheelFilter, WheelSample, _SampleRates
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.records import Pose

R, TRACK, EARTH, LIMIT = 0.3, 0.6, 3e-3, 34.0
SPEED, YAW_RATE, LEAN, ANGLE = 1.7, 0.8, 0.15, 1.1
LATE = 0.04
"""s from the pose to the sample."""

OFF = {
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


def at(still: MotionState, speed: float = SPEED, yaw_rate: float = YAW_RATE) -> Pose:
    return Pose(5.0, 2.0, 3.0, 0.4, speed, yaw_rate, np.eye(5), still, 0.0, 0)


def filtered(*sides: str, facing: str = "left", still: MotionState = MotionState.MOVING) -> WheelFilter:
    """With a pose at 5 s, and wheels whose errors are known."""
    nodes = {side: WheelNode(side, facing, gyro_limit=LIMIT) for side in sides}  # type: ignore[arg-type]
    made = WheelFilter(WheelConfig(R, TRACK, nodes, ground_rate=EARTH))
    made._pose = at(still)
    for wheel in made.core.wheels:
        wheel.angle_initialised = True
        made.core.x[wheel.columns[WHEEL_ANGLE]] = ANGLE
        for entry, value in OFF.items():
            made.core.x[wheel.columns[entry]] = value
    return made


def sample(made: WheelFilter, side: str, speed: float = SPEED, yaw_rate: float = YAW_RATE) -> WheelSample:
    """What the node on a wheel reads while the vehicle goes so: made the way that the errors come about."""
    (wheel,) = [wheel for wheel in made.core.wheels if wheel.name == side]
    sign = 1.0 if side == "left" else -1.0
    contact = 0.5 * sign * TRACK * (1.0 + OFF[TRACK_WIDTH])
    rolls = (speed - yaw_rate * contact) / (R * (1.0 + OFF[WHEEL_RADIUS]))
    about = rolls + sign * yaw_rate * math.sin(LEAN)
    angle = ANGLE + about * LATE
    felt = (1.0 + OFF[GYRO_SCALE_ACROSS]) * math.cos(LEAN) * (yaw_rate + EARTH) + OFF[YAW_RATE_FROM_GRAVITY]
    # Upwards in axes of the node, which turn with the wheel.
    true = np.array([felt * math.cos(angle), -felt * math.sin(angle), about])
    tilted = Rotation.from_rotvec([OFF[MISALIGNMENT_X], OFF[MISALIGNMENT_Y], 0.0]).inv().apply(true)
    read = np.array([tilted[0] + OFF[GYRO_BIAS_X], tilted[1] + OFF[GYRO_BIAS_Y], 0.0])
    read[2] = (1.0 + OFF[GYRO_SCALE_Z]) * about + OFF[GYRO_BIAS_Z]
    if wheel.node.facing == "right":
        read[1:] = -read[1:]
    return WheelSample(side, 5.0 + LATE, (read[0], read[1], read[2]), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("facing", ["left", "right"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_sample_shows_speed_and_yaw_rate_with_the_errors_of_its_node_taken_out(
    side: str, facing: str
) -> None:
    made = filtered(side, facing=facing)
    made._last_samples[side] = sample(made, side)
    t, speed, yaw_rate = made._rates_from_sample(made.core.wheels[0], made._pose)
    # A tilt is undone to its first order.
    assert (t, speed, yaw_rate) == (
        5.0 + LATE,
        pytest.approx(SPEED, abs=1e-4),
        pytest.approx(YAW_RATE, abs=1e-4),
    )


@pytest.mark.parametrize("facing", ["left", "right"])
def test_beyond_its_limit_a_gyro_is_believed_with_the_excess_alone(facing: str) -> None:
    made = filtered("left", facing=facing)
    x, wheel = made.core.x, made.core.wheels[0]
    for entry in OFF:
        x[wheel.columns[entry]] = 0.0
    x[wheel.columns[GYRO_BIAS_Z]], x[wheel.columns[RATE_BEYOND_RANGE]] = 0.5, 12.0
    spin = LIMIT if facing == "left" else -LIMIT
    made._last_samples["left"] = WheelSample("left", 5.0, (0.0, 0.0, spin), (0.0, 0.0, 0.0))
    _, speed, yaw_rate = made._rates_from_sample(wheel, made._pose)
    assert speed - yaw_rate * 0.5 * TRACK == pytest.approx(R * (LIMIT + 12.0))
    # Just below it what is known of bias and scale counts, and no excess.
    made._last_samples["left"] = WheelSample("left", 5.0, (0.0, 0.0, 0.999 * spin), (0.0, 0.0, 0.0))
    _, speed, yaw_rate = made._rates_from_sample(wheel, made._pose)
    assert speed - yaw_rate * 0.5 * TRACK == pytest.approx(R * (0.999 * LIMIT - 0.5))


def shown(made: WheelFilter, **told: tuple[float, float, float]) -> Any:
    made._sample_rates.update({side: _SampleRates(*rates) for side, rates in told.items()})
    return made.state()


def test_a_vehicle_goes_on_along_the_bend_at_the_mean_of_both_wheels() -> None:
    """From 1.7 m/s and 0.8 rad/s to 2.1 and 1.0 in 0.04 s, by the newest sample of the two."""
    state = shown(filtered("left", "right"), left=(5.02, 2.0, 0.9), right=(5.04, 2.2, 1.1))
    assert (state.t, state.speed, state.yaw_rate) == (5.04, pytest.approx(2.1), pytest.approx(1.0))
    heading = 0.4 + 0.9 * 0.04
    assert state.heading == pytest.approx(heading)
    arc = 1.9 / 0.9
    assert state.x == pytest.approx(2.0 + arc * (math.sin(heading) - math.sin(0.4)), abs=1e-5)
    assert state.y == pytest.approx(3.0 - arc * (math.cos(heading) - math.cos(0.4)), abs=1e-5)
    assert state.motion_state is MotionState.MOVING and np.array_equal(state.covariance, np.eye(5))


def test_a_sample_from_before_the_pose_says_nothing_and_one_of_its_time_does() -> None:
    state = shown(filtered("left", "right"), left=(4.99, 9.0, 9.0), right=(5.04, 2.1, 1.0))
    assert (state.t, state.speed, state.yaw_rate) == (5.04, 2.1, 1.0)
    state = shown(filtered("left", "right"), left=(4.99, 9.0, 9.0))
    assert (state.t, state.x, state.y, state.speed) == (5.0, 2.0, 3.0, SPEED)
    state = shown(filtered("left", "right"), left=(5.0, 2.1, 1.0))
    assert (state.t, state.x, state.y, state.speed) == (5.0, 2.0, 3.0, 2.1)


@pytest.mark.parametrize("still", [MotionState.STANDSTILL, MotionState.ROCKING])
def test_a_vehicle_that_stands_stays_where_it_is_while_time_goes_on(still: MotionState) -> None:
    state = shown(filtered("left", "right", still=still), left=(5.02, 9.0, 9.0), right=(5.04, 9.0, 9.0))
    assert (state.t, state.x, state.y, state.heading) == (5.04, 2.0, 3.0, 0.4)
    assert (state.speed, state.yaw_rate, state.motion_state) == (SPEED, YAW_RATE, still)


def test_only_wheels_whose_angle_is_known_are_asked() -> None:
    made = filtered("left", "right")
    for side in ("left", "right"):
        made._last_samples[side] = sample(made, side)
    made.core.wheels[1].angle_initialised = False
    assert made.state() is not None and set(made._sample_rates) == {"left"}
    assert WheelFilter(made.config).state() is None
