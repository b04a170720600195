"""Simulated drives: speed and yaw rate of their legs, limits, standstill at both ends, and the path."""

import numpy as np
import pytest

from hubodo.model.drive import Leg, integrate_path, loop_drive, random_drive, scripted_drive
from hubodo.model.inputs import MotionInputs
from hubodo.smoothing_spline import constant_spline

SEED = 411


def test_a_scripted_drive_has_the_speed_of_each_leg_at_its_middle():
    drive = scripted_drive([Leg(5.0, 0.0), Leg(6.0, 1.5, 0.2), Leg(4.0, -0.5, 0.0)])
    assert drive.speed.end == pytest.approx(15.0)
    middle = np.array([2.5, 8.0, 13.0])
    np.testing.assert_allclose(drive.speed(middle), [0.0, 1.5, -0.5], atol=1e-6)
    np.testing.assert_allclose(drive.yaw_rate(middle), [0.0, 0.2, 0.0], atol=1e-6)
    # Smoothed by a Gaussian with 1σ = 0.4 s: 16 % of the step is reached one sigma before the edge.
    np.testing.assert_allclose(
        drive.speed(np.array([5.0 - 0.4, 5.0, 5.0 + 0.4])), 1.5 * np.array([0.159, 0.5, 0.841]), atol=0.02
    )
    with pytest.raises(ValueError, match="positive duration"):
        scripted_drive([Leg(0.0, 1.0)])


@pytest.mark.parametrize("durations", [(), (0.0, 5.0), (5.0, -1.0), (0.0, 0.0)])
def test_a_drive_without_legs_or_with_a_leg_without_duration_is_refused(durations):
    with pytest.raises(ValueError, match="positive duration"):
        scripted_drive([Leg(duration, 1.0) for duration in durations])


@pytest.mark.parametrize("seed", range(SEED, SEED + 8))
def test_random_drives_respect_their_limits_and_start_and_end_at_standstill(seed):
    drive = random_drive(np.random.default_rng(seed), 60.0, max_speed=2.5)
    t = np.linspace(0.0, 60.0, 6001)
    speed, yaw_rate = drive.speed(t), drive.yaw_rate(t)
    assert drive.speed.end == pytest.approx(60.0, abs=0.011)
    assert np.abs(speed).max() <= 2.5 + 1e-6
    assert np.abs(yaw_rate).max() <= 1.2 + 1e-6
    assert np.abs(speed[[0, -1]]).max() < 1e-3
    assert speed.max() > 0.7


@pytest.mark.parametrize("seed", range(SEED, SEED + 8))
def test_a_loop_turns_by_about_one_revolution(seed):
    drive = loop_drive(np.random.default_rng(seed))
    assert drive.speed.end == pytest.approx(8.0 + 60.0 + 4.0, abs=0.011)
    _, _, _, heading = integrate_path(drive)
    # About ten legs, each up to 0.1 rad/s off for about 6 s: at most 1.2 rad (1σ).
    assert heading[-1] == pytest.approx(2.0 * np.pi, abs=3.6)


def test_the_path_of_a_constant_turn_is_a_circle():
    inputs = MotionInputs(constant_spline(2.0, 0.0, 10.0), constant_spline(0.5, 0.0, 10.0))
    t, x, y, heading = integrate_path(inputs)
    np.testing.assert_allclose(heading, 0.5 * t, atol=1e-12)
    np.testing.assert_allclose(x, 4.0 * np.sin(0.5 * t), atol=1e-9)
    np.testing.assert_allclose(y, 4.0 * (1 - np.cos(0.5 * t)), atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_drives_start_and_end_at_standstill_and_a_random_one_turns_both_ways(seed):
    rng = np.random.default_rng(seed)
    for drive, length in ((loop_drive(rng, driving_time=20.0), 32.0), (random_drive(rng, 90.0), 90.0)):
        t = np.arange(0.0, length, 0.01)
        assert drive.speed.end == pytest.approx(length, abs=0.02)
        for value in (drive.speed(t), drive.yaw_rate(t)):
            assert np.abs(value[[0, 1, -2, -1]]).max() < 1e-6, f"seed {seed}"
    assert drive.yaw_rate(t).min() < -0.2 < 0.2 < drive.yaw_rate(t).max(), f"seed {seed}"
    assert 0.8 < drive.speed(t).max() <= 2.5, f"seed {seed}"
