"""When a wheel that spun by itself is believed again: touched down, gone on evenly, or given up on."""

from __future__ import annotations

import math

import pytest

from hubodo.fuse.wheel.slip_detector import ForwardResidual, SlipDetector

CALM = ForwardResidual(0.0, 1e-4, 0.0, 0.0, 0.0, 0.0)
SHAKEN = CALM._replace(residual=1.0)
SPUN = 2.0
"""m/s that it turned faster than the road at most."""


def followed(*phases, carried=None, fastest=2.0, sign=1.0):
    """(window in which it is believed again, last of the slip) of a wheel that has slipped from window 0 on.

    phases: (windows, push, slip in m/s, its 1 sigma). None where it is not.
    """
    grip, number = SlipDetector(), 0
    grip.start_slip(0)
    for windows, push, slip, sigma in ((1, SHAKEN, SPUN, 0.2), *phases):
        for _ in range(windows):
            number += 1
            if push is not None:
                push = push._replace(speed_gain=math.copysign(push.speed_gain, push.speed_gain * sign))
            if grip.detect_end(number, push, sign * slip, sigma**2, carried, fastest):
                assert not grip.is_slipping and abs(grip.slips[-1].speed) == SPUN
                assert math.copysign(1.0, grip.slips[-1].speed) == sign
                return number, grip.slips[-1].last
    assert grip.is_slipping
    return None


def touching(by):
    """A window in which it loses `by`, m/s, by itself."""
    return (1, SHAKEN._replace(speed_gain=-by), SPUN, 0.2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("carried", [None, 1.0])
def test_one_that_lost_half_of_its_slip_at_once_is_believed_after_half_a_second_near_the_road(carried, sign):
    def back(*windows):
        grip = SlipDetector()
        grip.start_slip(0)
        for number, (gain, slip) in enumerate(windows, 1):
            push = SHAKEN._replace(speed_gain=sign * gain)
            assert not grip.detect_end(number, push, sign * slip, 0.04, carried, 2.0)
        for number in range(len(windows) + 1, 60):
            if grip.detect_end(number, CALM, 0.0, 0.04, carried, 2.0):
                return number - len(windows), grip.slips[-1].last - len(windows)
        return None

    at_once, lingering = (5, 0), (30, 0)
    assert back((0.0, SPUN), (-1.02, SPUN)) == at_once
    assert back((0.0, SPUN), (-0.98, SPUN)) == lingering
    assert back((0.0, SPUN), (-0.6, SPUN), (-0.6, SPUN)) == at_once
    # What it gains meanwhile counts against that, what it gained before does not.
    assert back((0.0, SPUN), (-1.1, SPUN), (0.2, SPUN)) == lingering
    assert back((5.0, SPUN), (-1.02, SPUN)) == at_once


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("sigma", "edge"), [(1.0, 0.35 * SPUN + 0.05), (0.1, 3 * 0.1 + 0.05)])
def test_near_is_what_sigma_says_but_no_more_than_a_third_of_the_slip(sigma, edge, sign):
    for slip, found in ((edge - 0.01, (31, 1)), (edge + 0.01, None)):
        assert followed((40, CALM, slip, sigma), sign=sign) == found


def test_beside_another_wheel_one_that_keeps_to_its_speed_is_believed_however_it_shakes():
    for push in (SHAKEN, None, CALM):
        assert followed((40, push, 0.0, 0.2)) == (31, 1)
    # Five windows do only where the accelerometer agrees as well.
    assert followed(touching(1.5), (40, SHAKEN, 0.0, 0.2)) == (32, 2)
    assert followed((20, SHAKEN, 0.0, 0.2), (1, SHAKEN, 1.0, 0.2), (40, SHAKEN, 0.0, 0.2)) == (52, 22)
    assert followed((20, CALM, 0.0, 0.2), (1, CALM, 1.0, 0.2), (40, CALM, 0.0, 0.2)) == (52, 22)


@pytest.mark.parametrize("push", [SHAKEN, None])
def test_where_the_speed_is_carried_it_has_to_agree_with_its_accelerometer(push):
    assert followed((190, push, 0.0, 0.2), carried=1.0) is None
    assert followed((20, CALM, 0.0, 0.2), (1, push, 0.0, 0.2), (40, CALM, 0.0, 0.2), carried=1.0) == (52, 22)


def test_one_that_agrees_for_ten_seconds_is_believed_against_a_speed_that_was_carried():
    assert followed((150, CALM, 1.0, 0.1), carried=1.0) == (101, 100)
    assert followed((150, CALM, 1.0, 0.1)) is None
    assert followed((95, CALM, 1.0, 0.1), (1, None, 1.0, 0.1), (95, CALM, 1.0, 0.1), carried=1.0) is None


def test_it_agrees_within_three_sigmas_and_what_stays():
    """0.05 m/s² for 0.1 s beside noise of 0.01 m/s."""
    edge = math.hypot(3 * 0.01, 0.05 * 0.1)
    for share, found in ((0.99, (101, 100)), (1.01, None)):
        for sign in (1.0, -1.0):
            push = CALM._replace(residual=sign * share * edge)
            assert followed((110, push, 1.0, 0.1), carried=1.0) == found


@pytest.mark.parametrize(
    ("residual", "gain", "windows"),
    [(0.0, 0.02, 10), (0.01, 0.021, 5), (-0.01, 0.03, 14), (0.01, -0.02, 100), (0.0, 0.3, 5)],
)
def test_one_that_follows_the_changes_of_speed_is_believed_as_soon_as_that_is_likely(residual, gain, windows):
    """By the logarithm of the likelihoods of what is felt, residual + gain, were it 0 or as the wheel has it:
    20 of it, of noise of 0.01 m/s. Its sum never falls below none at all, and no window alone decides."""
    push = CALM._replace(residual=residual, speed_gain=gain)
    each = min(0.5 * ((residual + gain) ** 2 - residual**2) / 0.01**2, 20.0 / 5)
    if each > 0.0:
        assert windows == math.ceil(20.0 / each - 1e-9)
    assert followed((150, push, 1.0, 0.1), carried=1.0) == (1 + windows, windows)
    against = CALM._replace(residual=0.01, speed_gain=-0.015)
    assert followed((20, against, 1.0, 0.1), (150, push, 1.0, 0.1), carried=1.0) == (
        21 + min(windows, 80),
        20 + min(windows, 80),
    )
    some = (min(windows, 95) - 1, push, 1.0, 0.1)
    assert followed(some, (1, SHAKEN, 1.0, 0.1), some, carried=1.0) is None
    assert followed((150, push, 1.0, 0.1)) is None


@pytest.mark.parametrize(
    ("carried", "slip", "sigma", "given_up"),
    [
        (3.6, -0.2, 0.1, True),
        (-3.6, 0.2, 0.1, True),
        (3.6, -0.05, 0.1, False),
        (3.6, -7.2, 0.1, False),
        (3.4, -0.2, 0.1, False),
        (0.0, 1.0, 3.49, False),
        (0.0, 1.0, 3.51, True),
        (None, 1.0, 3.51, False),
    ],
)
def test_a_carried_speed_half_as_fast_again_as_ever_is_given_up_for_a_slower_wheel(
    carried, slip, sigma, given_up
):
    """1.5 times 2 m/s and 0.5 m/s beside that; nor is one believed that is not known as well as that."""
    grip = SlipDetector()
    grip.start_slip(7)
    assert grip.detect_end(9, SHAKEN, slip, sigma**2, carried, 2.0) == given_up
    assert grip.slips[-1].last == (8 if given_up else None)


def settled(grip):
    """Whether its accelerometer may contradict the wheel at once."""
    return any(grip.detect_onset(1000 + n, CALM._replace(residual=0.5), 2.0) is not None for n in range(15))


def rolled(windows=20):
    grip = SlipDetector()
    for number in range(windows):
        assert grip.detect_onset(number, CALM, 2.0) is None
    return grip


def test_a_slip_that_ended_by_itself_may_be_followed_by_the_next_and_one_given_up_on_may_not():
    assert settled(rolled()) and not settled(rolled(19))
    ended = rolled()
    ended.start_slip(20)
    for number in range(21, 55):
        ended.detect_end(number, CALM, 0.0, 0.04, None, 2.0)
    assert not ended.is_slipping and settled(ended)
    for given_up in ({"number": 220}, {"number": 21, "inertial_speed": 9.0}):
        grip = rolled()
        grip.start_slip(20)
        told = {"forward": SHAKEN, "slip": -8.0, "variance": 0.04, "inertial_speed": None, "max_speed": 2.0}
        assert grip.detect_end(**{**told, **given_up})
        assert grip.slips[-1].last == given_up["number"] - 1
        assert not settled(grip)


def test_a_wheel_that_was_not_heard_begins_anew_as_one_that_rolls():
    slipping, rolling = rolled(), rolled()
    slipping.start_slip(20)
    for grip in (slipping, rolling):
        grip.end_by_outage(45)
        assert not grip.is_slipping and not settled(grip)
    assert [slip.last for slip in slipping.slips] == [45]
    assert rolling.slips == []


def test_a_new_slip_knows_nothing_of_the_one_before():
    grip = SlipDetector()
    for first in (0, 50):
        grip.start_slip(first)
        assert not grip.detect_end(
            first + 1, SHAKEN._replace(speed_gain=-3.0 + 0.06 * first), SPUN, 0.04, 1.0, 2.0
        )
        calm = [grip.detect_end(first + n, CALM, 0.0, 0.04, 1.0, 2.0) for n in range(2, 40)]
        assert calm.index(True) == (4 if first == 0 else 29)


def test_a_slip_is_told_in_seconds_and_words():
    grip = SlipDetector()
    grip.start_slip(12)
    slip = grip.slips[-1]
    assert slip.start == pytest.approx(1.2) and slip.end == math.inf
    assert slip.description.startswith("t = 1.2 s and on")
    slip.last, slip.speed = 34, -0.44
    assert slip.end == pytest.approx(3.5)
    assert "t = 1.2 to 3.5 s" in slip.description and "up to 0.4 m/s slower than the road" in slip.description
    slip.speed = 0.44
    assert "up to 0.4 m/s faster than the road" in slip.description
