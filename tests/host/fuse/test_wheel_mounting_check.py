"""Two wheels beside each other: which mounting, which axle, and when that is said."""

from __future__ import annotations

import math

import pytest

from hubodo.fuse.wheel.mounting_check import BOTH_WHEELS, MountingCheck, track_width_test

TRACK = 0.5


def windows(agreement, count, left, right, yaws):
    """(number of the window with a verdict, what was said) of `count` windows alike; None where none is.

    yaws: rad/s that the gyros of the left and the right wheel feel, by number of the window.
    """
    for number in range(1, count + 1):
        said = agreement.add(yaws(number) if callable(yaws) else yaws, left, right)
        if said is not None:
            return number, said
    return None


def rolling(yaw_rate, speed=1.0):
    """m/s of the left and the right wheel of a vehicle that turns so."""
    return speed - 0.5 * TRACK * yaw_rate, speed + 0.5 * TRACK * yaw_rate


def test_what_is_mounted_as_declared_is_never_blamed_and_settled_after_five_minutes():
    agreement = MountingCheck(TRACK)
    for number in range(3000):
        assert agreement.is_undecided
        yaw_rate = 0.8 * math.sin(0.01 * number)
        assert agreement.add((yaw_rate, yaw_rate), *rolling(yaw_rate)) is None
    assert not agreement.is_undecided and not agreement.verdict
    assert agreement.usable_side == 0.0 and not agreement.sides_swapped and not agreement.other_wheel_steers


@pytest.mark.parametrize(
    ("left", "right", "counts"),
    [(0.09, 0.09, 0), (0.09, -0.09, 0), (0.11, 0.0, 1), (0.0, 0.11, 1), (-0.11, 0.0, 1), (0.0, -0.11, 1)],
)
def test_a_window_counts_where_one_wheel_moves(left, right, counts):
    agreement = MountingCheck(TRACK)
    agreement.add((0.3, 0.5), left, right)
    assert agreement.count == counts
    assert agreement.wheel_distances == pytest.approx([0.1 * left * counts, 0.1 * right * counts])
    assert agreement.turned_angle == pytest.approx(0.1 * 0.4 * counts)


YAW = 0.5
LEFT, RIGHT = rolling(YAW)


@pytest.mark.parametrize(
    ("left", "right", "said", "alone", "exchanged", "words"),
    [
        (-LEFT, RIGHT, 1.0, -1.0, False, "the node on the left wheel"),
        (LEFT, -RIGHT, -1.0, 1.0, False, "the node on the right wheel"),
        (-LEFT, -RIGHT, BOTH_WHEELS, 0.0, False, "both nodes are mounted the other way round"),
        (RIGHT, LEFT, BOTH_WHEELS, 1.0, True, "the sides of the two nodes are exchanged"),
    ],
)
@pytest.mark.parametrize("turning", [1.0, -1.0])
def test_each_wrong_mounting_is_named_after_a_second_of_a_bend(
    left, right, said, alone, exchanged, words, turning
):
    agreement = MountingCheck(TRACK)
    if turning < 0.0:
        # The mirrored bend changes both speeds with each other.
        left, right = math.copysign(right, left), math.copysign(left, right)
    assert windows(agreement, 50, left, right, (turning * YAW, turning * YAW)) == (10, said)
    assert words in agreement.verdict and not agreement.is_undecided
    assert (agreement.usable_side, agreement.sides_swapped) == (alone, exchanged)


@pytest.mark.parametrize("turning", [1.0, -1.0])
def test_sides_that_are_exchanged_are_named_where_the_vehicle_turns_on_the_spot(turning):
    agreement = MountingCheck(TRACK)
    left, right = rolling(turning * YAW, speed=0.0)
    assert windows(agreement, 50, right, left, (turning * YAW, turning * YAW)) == (10, BOTH_WHEELS)
    assert "the sides of the two nodes are exchanged" in agreement.verdict and agreement.sides_swapped


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_mounting_explains_the_yaw_where_it_misses_it_by_less_than_two_tenths(sign):
    """Of a left node that is mounted the other way round, with gyros that feel `off` besides."""
    for off, found in ((0.19, (10, 1.0)), (0.21, None)):
        felt = YAW + sign * off
        assert windows(MountingCheck(TRACK), 15, -LEFT, RIGHT, (felt, felt)) == found


@pytest.mark.parametrize("off", [0.0, 0.05])
def test_another_mounting_is_believed_where_the_declared_one_is_six_times_as_wrong(off):
    """Sides exchanged at a yaw rate r that the gyros feel with an error: 2 r + off against off, and 0.02."""
    edge = 0.5 * (math.sqrt(6.0 * (off**2 + 0.02**2)) - off)
    for share, found in ((0.98, None), (1.02, (10, BOTH_WHEELS))):
        left, right = rolling(share * edge)
        felt = share * edge + off
        assert windows(MountingCheck(TRACK), 15, right, left, (felt, felt)) == found


@pytest.mark.parametrize(("first", "side"), [(True, 1.0), (False, -1.0)])
def test_the_wheel_that_turns_more_than_the_other_is_the_one_that_steers(first, side):
    """By 0.03 rad/s and a tenth of the yaw rate, after two seconds."""
    edge = math.hypot(0.03, 0.1 * 0.6)
    for share, found in ((0.98, None), (1.02, (20, side))):
        more = 0.6 + share * edge
        yaws = (more, 0.6) if first else (0.6, more)
        agreement = MountingCheck(TRACK)
        assert windows(agreement, 40, *rolling(0.5 * (0.6 + more)), yaws) == found
        assert agreement.other_wheel_steers == (found is not None)
        assert agreement.usable_side == (-side if found else 0.0)
        assert bool(agreement.verdict) == agreement.other_wheel_steers
    assert "steers" in agreement.verdict


def test_a_wheel_is_said_to_steer_where_it_has_at_least_half_of_the_difference_to_itself():
    """Beside a steady bend one swings by s to and fro, the other by -b s: (1 - b²) of (1 + b)² is its own."""
    for share, found in ((0.52, (20, 1.0)), (0.48, None)):
        b = (1.0 - share) / (1.0 + share)

        def swinging(number, b=b):
            s = 0.3 * (-1.0) ** number
            return 0.6 + s, 0.6 - b * s

        assert windows(MountingCheck(TRACK), 21, *rolling(0.6), swinging) == found


def winding(agreement, count, rate, off=0.0, sizes=(1.0, 1.0)):
    """As `windows`, through bends to both sides in turn: yaw rates are felt as they are, and rolled as `off`.

    sizes: times as fast as it rolls that a wheel seems to, left and right.
    """
    for number in range(1, count + 1):
        side = 1.0 if number % 2 else -1.0
        left, right = rolling(side * (rate + off))
        said = agreement.add((side * rate, side * rate), sizes[0] * left, sizes[1] * right)
        if said is not None:
            return number, said
    return None


@pytest.mark.parametrize("turning", [1.0, -1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_speeds_that_make_another_yaw_than_is_felt_are_not_of_that_axle(turning, sign):
    """By 0.04 rad/s and a fifth of the yaw rate, once three rad were turned."""
    rate = 0.52
    edge = math.hypot(0.04, 0.2 * rate)
    for share, found in ((0.98, None), (1.05, (58, -1.0))):
        agreement = MountingCheck(TRACK)
        assert winding(agreement, 100, turning * rate, sign * share * edge) == found
        assert agreement.other_wheel_steers == bool(found) and agreement.usable_side == float(bool(found))
    assert "axle of 0.5 m" in agreement.verdict


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rate", [0.0, 0.52, -0.52])
def test_wheels_of_unequal_size_are_still_an_axle(rate, sign):
    """4 m/s on a track of half a metre, by a tenth, which is 0.8 rad/s; by more no tape is off."""
    for more, found in ((0.04, None), (0.095, None), (0.2, (100, -1.0))):
        agreement, said = MountingCheck(TRACK), None
        for number in range(1, 101):
            left, right = rolling(rate, 4.0)
            agreement.turned_angle = max(agreement.turned_angle, 4.0 * (number == 100))
            said = agreement.add(
                (rate, rate), left * (1.0 - 0.5 * sign * more), right * (1.0 + 0.5 * sign * more)
            )
        assert (None if said is None else (number, said)) == found, more


def test_a_wheel_that_slips_for_a_moment_is_no_other_axle():
    """However wild, a window counts as sixteen that are at the edge: four of them in 58 make a verdict."""
    for wild, found in ((3, None), (4, (58, -1.0))):
        agreement = MountingCheck(TRACK)
        said = windows(agreement, wild, *rolling(0.52 + 4.0), (0.52, 0.52))
        assert said is None
        last = windows(agreement, 58 - wild, *rolling(0.52), (0.52, 0.52))
        assert last == (found and (58 - wild, -1.0))


@pytest.mark.parametrize("prior", [0.02, 0.1])
def test_a_tape_is_not_asked_before_the_drive_has_shown_the_track_to_a_hundredth(prior):
    for shown, asked in ((0.0099, True), (0.0101, False)):
        variance = 1.0 / (1.0 / shown**2 + 1.0 / prior**2)
        assert (track_width_test(0.0, variance, prior) is not None) == asked
    assert track_width_test(0.0, prior**2, prior) is None
