"""Continuous /odom: steps within what the speed allows plus the slew rate, and agreement at the end."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hubodo.ingest.live.continuous_odom import SLEW_SPEED, SLEW_TIME, SLEW_YAW_RATE, ContinuousOdom

STEP = 0.01  # s


@pytest.mark.parametrize(("jump", "turn"), [(0.3, 0.05), (-0.02, -0.2), (6.0, 0.4)])
def test_a_jump_of_the_filter_is_slewed_and_complete_after_a_bounded_time(jump: float, turn: float) -> None:
    """The filter drives a circle at 1 m/s and jumps sideways and in heading after 2 s."""
    odom, speed, yaw_rate = ContinuousOdom(), 1.0, 0.2
    published, raw = [], []
    x = y = heading = 0.0
    for number in range(3000):
        if number == 200:
            y, heading = y + jump, heading + turn
        raw.append((x, y, heading))
        published.append(odom.update(number * STEP, x, y, heading, speed, yaw_rate))
        course = heading + 0.5 * yaw_rate * STEP
        x, y = x + speed * STEP * math.cos(course), y + speed * STEP * math.sin(course)
        heading += yaw_rate * STEP
    steps = np.abs(np.diff(np.array(published), axis=0))
    slew = max(SLEW_SPEED, abs(jump) / SLEW_TIME)
    assert np.hypot(steps[:, 0], steps[:, 1]).max() <= (speed + slew) * STEP * 1.01
    # A heading that is off by `turn` meanwhile moves the position too, so the offset grows.
    assert steps[:, 2].max() <= (yaw_rate + max(SLEW_YAW_RATE, abs(turn) / SLEW_TIME)) * STEP * 1.001
    assert published[-1] == raw[-1]
    assert published[100] == raw[100]


def test_a_filter_without_corrections_is_published_unchanged() -> None:
    odom = ContinuousOdom()
    rng = np.random.default_rng(4)
    for number in range(100):
        pose = (number * STEP + 1e-4 * rng.standard_normal(), 0.0, 0.0)
        assert odom.update(number * STEP, *pose, 1.0, 0.0) == pose
    covariance = np.eye(5)
    assert odom.covariance(covariance) is covariance


def test_the_correction_that_remains_widens_the_covariance() -> None:
    odom = ContinuousOdom()
    odom.update(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    x, y, heading = odom.update(STEP, 0.3, -0.1, 0.2, 0.0, 0.0)
    error = np.array([x - 0.3, y + 0.1, heading - 0.2])
    assert odom.covariance(np.zeros((5, 5)))[:3, :3] == pytest.approx(np.outer(error, error))
    assert odom.to_published(1.3, -0.1, 0.2) == pytest.approx(
        (1.3 + error[0], -0.1 + error[1], 0.2 + error[2])
    )
