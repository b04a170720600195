"""Mounting check of two wheels: which mounting, which axle, and when a verdict is given."""

from __future__ import annotations

import math

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.fuse.wheel.mounting_check import BOTH_WHEELS, MountingCheck, track_width_test
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.recording import Table
from wheel_runs import config, tables

TRACK = 0.5


def check_constant_windows(check, count, left, right, yaw_rates):
    """Return (window number, verdict) of the first verdict in `count` equal windows, else None.

    yaw_rates: rad/s of the left and the right gyro, or a function of the window number that returns them.
    """
    for number in range(1, count + 1):
        verdict = check.add(yaw_rates(number) if callable(yaw_rates) else yaw_rates, left, right)
        if verdict is not None:
            return number, verdict
    return None


def wheel_speeds(yaw_rate, speed=1.0):
    """Return the speeds, m/s, of the left and the right wheel at a yaw rate, rad/s."""
    return speed - 0.5 * TRACK * yaw_rate, speed + 0.5 * TRACK * yaw_rate


def test_a_correct_mounting_is_confirmed_after_five_minutes_without_a_verdict():
    check = MountingCheck(TRACK)
    for number in range(3000):
        assert check.is_undecided
        yaw_rate = 0.8 * math.sin(0.01 * number)
        assert check.add((yaw_rate, yaw_rate), *wheel_speeds(yaw_rate)) is None
    assert not check.is_undecided and not check.verdict
    assert check.usable_side == 0.0 and not check.sides_swapped and not check.other_wheel_steers


@pytest.mark.parametrize(
    ("left", "right", "count"),
    [(0.09, 0.09, 0), (0.09, -0.09, 0), (0.11, 0.0, 1), (0.0, 0.11, 1), (-0.11, 0.0, 1), (0.0, -0.11, 1)],
)
def test_a_window_counts_if_a_wheel_exceeds_the_minimum_speed(left, right, count):
    check = MountingCheck(TRACK)
    check.add((0.3, 0.5), left, right)
    assert check.count == count
    assert check.wheel_distances == pytest.approx([0.1 * left * count, 0.1 * right * count])
    assert check.turned_angle == pytest.approx(0.1 * 0.4 * count)


YAW = 0.5
LEFT, RIGHT = wheel_speeds(YAW)


@pytest.mark.parametrize(
    ("left", "right", "verdict", "usable_side", "swapped", "text"),
    [
        (-LEFT, RIGHT, 1.0, -1.0, False, "the node on the left wheel"),
        (LEFT, -RIGHT, -1.0, 1.0, False, "the node on the right wheel"),
        (-LEFT, -RIGHT, BOTH_WHEELS, 0.0, False, "both nodes are mounted the other way round"),
        (RIGHT, LEFT, BOTH_WHEELS, 1.0, True, "the sides of the two nodes are exchanged"),
    ],
)
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_each_wrong_mounting_is_named_after_one_second_of_turning(
    left, right, verdict, usable_side, swapped, text, direction
):
    check = MountingCheck(TRACK)
    if direction < 0.0:
        # In the mirrored bend the two speeds are exchanged.
        left, right = math.copysign(right, left), math.copysign(left, right)
    assert check_constant_windows(check, 50, left, right, (direction * YAW, direction * YAW)) == (10, verdict)
    assert text in check.verdict and not check.is_undecided
    assert (check.usable_side, check.sides_swapped) == (usable_side, swapped)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_swapped_sides_are_named_while_turning_on_the_spot(direction):
    check = MountingCheck(TRACK)
    left, right = wheel_speeds(direction * YAW, speed=0.0)
    assert check_constant_windows(check, 50, right, left, (direction * YAW, direction * YAW)) == (
        10,
        BOTH_WHEELS,
    )
    assert "the sides of the two nodes are exchanged" in check.verdict and check.sides_swapped


@pytest.mark.parametrize("offset", [0.0, 0.05])
def test_another_mounting_is_accepted_at_a_ninth_of_the_squared_residual(offset):
    """Sides swapped, gyro error `offset`: residuals 2 r + offset against offset, with a floor of 0.03
    rad/s.
    """
    limit = 0.5 * (math.sqrt(9.0 * (offset**2 + 0.03**2)) - offset)
    for factor, expected in ((0.98, None), (1.02, (10, BOTH_WHEELS))):
        left, right = wheel_speeds(factor * limit)
        yaw_rate = factor * limit + offset
        assert check_constant_windows(MountingCheck(TRACK), 15, right, left, (yaw_rate, yaw_rate)) == expected


@pytest.mark.parametrize(("left_steers", "side"), [(True, 1.0), (False, -1.0)])
def test_the_wheel_with_the_larger_yaw_rate_is_the_steered_one(left_steers, side):
    """The limit is 0.03 rad/s and a tenth of the yaw rate, judged after two seconds."""
    limit = math.hypot(0.03, 0.1 * 0.6)
    for factor, expected in ((0.98, None), (1.02, (20, side))):
        larger = 0.6 + factor * limit
        yaw_rates = (larger, 0.6) if left_steers else (0.6, larger)
        check = MountingCheck(TRACK)
        assert check_constant_windows(check, 40, *wheel_speeds(0.5 * (0.6 + larger)), yaw_rates) == expected
        assert check.other_wheel_steers == (expected is not None)
        assert check.usable_side == (-side if expected else 0.0)
        assert bool(check.verdict) == check.other_wheel_steers
    assert "steers" in check.verdict


def test_a_steered_wheel_has_at_least_half_of_the_difference_to_itself():
    """One wheel oscillates by s about a steady bend, the other by -b s: its share is (1 - b²) of (1 + b)²."""
    for share, expected in ((0.52, (20, 1.0)), (0.48, None)):
        b = (1.0 - share) / (1.0 + share)

        def oscillating(number, b=b):
            s = 0.3 * (-1.0) ** number
            return 0.6 + s, 0.6 - b * s

        assert check_constant_windows(MountingCheck(TRACK), 21, *wheel_speeds(0.6), oscillating) == expected


def check_alternating_bends(check, count, rate, offset=0.0, size_factors=(1.0, 1.0)):
    """Return (window number, verdict) of the first verdict in bends that alternate in direction, else None.

    The gyros measure `rate`, the wheels roll at `rate + offset`; size_factors scale the speed of the left and
    the right wheel.
    """
    for number in range(1, count + 1):
        side = 1.0 if number % 2 else -1.0
        left, right = wheel_speeds(side * (rate + offset))
        verdict = check.add((side * rate, side * rate), size_factors[0] * left, size_factors[1] * right)
        if verdict is not None:
            return number, verdict
    return None


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_yaw_rate_from_speeds_unlike_the_gyros_means_another_axle(direction, sign):
    """The limit is 0.03 rad/s and a fifth of the yaw rate, judged after 3 rad of turning."""
    rate = 0.52
    limit = math.hypot(0.03, 0.2 * rate)
    for factor, expected in ((0.98, None), (1.05, (58, -1.0))):
        check = MountingCheck(TRACK)
        assert check_alternating_bends(check, 100, direction * rate, sign * factor * limit) == expected
        assert check.other_wheel_steers == bool(expected) and check.usable_side == float(bool(expected))
    assert "axle of 0.5 m" in check.verdict


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rate", [0.0, 0.52, -0.52])
def test_wheels_of_unequal_size_up_to_a_tenth_belong_to_one_axle(rate, sign):
    """A size difference of 10 % at 4 m/s on a track of 0.5 m appears as 0.8 rad/s; tapes are never worse."""
    for size_difference, expected in ((0.04, None), (0.095, None), (0.2, (100, -1.0))):
        check, verdict = MountingCheck(TRACK), None
        for number in range(1, 101):
            left, right = wheel_speeds(rate, 4.0)
            check.turned_angle = max(check.turned_angle, 4.0 * (number == 100))
            verdict = check.add(
                (rate, rate),
                left * (1.0 - 0.5 * sign * size_difference),
                right * (1.0 + 0.5 * sign * size_difference),
            )
        assert (None if verdict is None else (number, verdict)) == expected, size_difference


def test_a_short_slip_does_not_mean_another_axle():
    """A window counts at most as nine at the limit: seven outliers among 58 windows give a verdict."""
    for outliers, expected in ((6, None), (7, (58, -1.0))):
        check = MountingCheck(TRACK)
        verdict = check_constant_windows(check, outliers, *wheel_speeds(0.52 + 4.0), (0.52, 0.52))
        assert verdict is None
        last = check_constant_windows(check, 58 - outliers, *wheel_speeds(0.52), (0.52, 0.52))
        assert last == (expected and (58 - outliers, -1.0))


@pytest.mark.parametrize("prior", [0.02, 0.1])
def test_the_track_width_is_tested_once_the_drive_determines_it_to_one_percent(prior):
    for drive_sigma, expected in ((0.0099, True), (0.0101, False)):
        variance = 1.0 / (1.0 / drive_sigma**2 + 1.0 / prior**2)
        assert (track_width_test(0.0, variance, prior) is not None) == expected
    assert track_width_test(0.0, prior**2, prior) is None


@pytest.mark.parametrize("seed", [0, 1])
def test_wheels_of_a_log_that_begins_in_motion_do_not_seem_to_steer(seed):
    rng = np.random.default_rng([seed, 34])
    plan = wheel_drives.ramps([(1.0, 0.0, 0.0), (6.0, 6.0, 0.0), (4.0, 5.0, 0.15)])
    drive = wheel_drives.drive(plan, rng, radius=0.3, track=1.4)
    moving = {
        name: Table({column: values[table.t > 5.0] for column, values in table.columns.items()})
        for name, table in tables(drive).items()
    }
    run = run_wheel_filter(config(drive), moving)
    # The first windows leak 0.1 to 1 rad/s of the spin into the yaw rates, as biases and tilts are unknown.
    check = run.filter.core.mounting_check
    assert check.count > 20 and not check.verdict
