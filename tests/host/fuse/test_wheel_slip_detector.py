"""End of a slip: after touching the road, after smooth agreement, or because the slip lasts too long."""

from __future__ import annotations

import math

import pytest

from hubodo.fuse.wheel.slip_detector import ForwardResidual, SlipDetector

AGREEING = ForwardResidual(0.0, 1e-4, 0.0, 0.0, 0.0, 0.0)
DISAGREEING = AGREEING._replace(residual=1.0)
LARGEST_SLIP = 2.0
"""Largest speed by which the wheel was faster than the road, m/s."""


def detect_slip_end(*phases, inertial_speed=None, max_speed=2.0, sign=1.0):
    """Return (window in which the slip ends, its last slipping window); None while it lasts.

    The wheel slips from window 0 on. phases: (number of windows, ForwardResidual, slip in m/s, its sigma).
    """
    detector, number = SlipDetector(), 0
    detector.start_slip(0)
    for windows, forward, slip, sigma in ((1, DISAGREEING, LARGEST_SLIP, 0.2), *phases):
        for _ in range(windows):
            number += 1
            if forward is not None:
                forward = forward._replace(
                    speed_gain=math.copysign(forward.speed_gain, forward.speed_gain * sign)
                )
            if detector.detect_end(number, forward, sign * slip, sigma**2, inertial_speed, max_speed):
                assert not detector.is_slipping and abs(detector.slips[-1].speed) == LARGEST_SLIP
                assert math.copysign(1.0, detector.slips[-1].speed) == sign
                return number, detector.slips[-1].last
    assert detector.is_slipping
    return None


def touchdown(lost_speed):
    """Return a phase of one window in which the wheel loses `lost_speed`, m/s, by itself."""
    return (1, DISAGREEING._replace(speed_gain=-lost_speed), LARGEST_SLIP, 0.2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("inertial_speed", [None, 1.0])
def test_after_losing_half_of_its_slip_at_once_a_wheel_is_trusted_after_half_a_second(inertial_speed, sign):
    def windows_to_end(*windows):
        detector = SlipDetector()
        detector.start_slip(0)
        for number, (gain, slip) in enumerate(windows, 1):
            forward = DISAGREEING._replace(speed_gain=sign * gain)
            assert not detector.detect_end(number, forward, sign * slip, 0.04, inertial_speed, 2.0)
        for number in range(len(windows) + 1, 60):
            if detector.detect_end(number, AGREEING, 0.0, 0.04, inertial_speed, 2.0):
                return number - len(windows), detector.slips[-1].last - len(windows)
        return None

    fast_end, slow_end = (5, 0), (20, 0)
    assert windows_to_end((0.0, LARGEST_SLIP), (-1.02, LARGEST_SLIP)) == fast_end
    assert windows_to_end((0.0, LARGEST_SLIP), (-0.98, LARGEST_SLIP)) == slow_end
    assert windows_to_end((0.0, LARGEST_SLIP), (-0.6, LARGEST_SLIP), (-0.6, LARGEST_SLIP)) == fast_end
    # A gain after the loss counts against it, a gain before the loss does not.
    assert windows_to_end((0.0, LARGEST_SLIP), (-1.1, LARGEST_SLIP), (0.2, LARGEST_SLIP)) == slow_end
    assert windows_to_end((5.0, LARGEST_SLIP), (-1.02, LARGEST_SLIP)) == fast_end


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("sigma", "limit"), [(1.0, 0.5 * LARGEST_SLIP), (0.1, 3 * 0.1)])
def test_near_the_road_speed_means_three_sigma_but_at_most_half_of_the_slip(sigma, limit, sign):
    for slip, expected in ((limit - 0.01, (21, 1)), (limit + 0.01, None)):
        assert detect_slip_end((40, AGREEING, slip, sigma), sign=sign) == expected


def test_near_the_speed_of_another_wheel_a_slip_ends_whatever_the_accelerometer_measures():
    for forward in (DISAGREEING, None, AGREEING):
        assert detect_slip_end((40, forward, 0.0, 0.2)) == (21, 1)
    # Five windows are enough only if the accelerometer agrees as well.
    assert detect_slip_end(touchdown(1.5), (40, DISAGREEING, 0.0, 0.2)) == (22, 2)
    assert detect_slip_end(
        (19, DISAGREEING, 0.0, 0.2), (1, DISAGREEING, 1.0, 0.2), (40, DISAGREEING, 0.0, 0.2)
    ) == (41, 21)
    assert detect_slip_end((19, AGREEING, 0.0, 0.2), (1, AGREEING, 1.0, 0.2), (40, AGREEING, 0.0, 0.2)) == (
        41,
        21,
    )


@pytest.mark.parametrize("forward", [DISAGREEING, None])
def test_with_an_inertial_speed_a_slip_ends_only_if_the_accelerometer_agrees(forward):
    assert detect_slip_end((190, forward, 0.0, 0.2), inertial_speed=1.0) is None
    assert detect_slip_end(
        (19, AGREEING, 0.0, 0.2), (1, forward, 0.0, 0.2), (40, AGREEING, 0.0, 0.2), inertial_speed=1.0
    ) == (41, 21)


def test_ten_seconds_of_agreement_outweigh_an_inertial_speed():
    assert detect_slip_end((150, AGREEING, 1.0, 0.1), inertial_speed=1.0) == (101, 100)
    assert detect_slip_end((150, AGREEING, 1.0, 0.1)) is None
    assert (
        detect_slip_end(
            (95, AGREEING, 1.0, 0.1), (1, None, 1.0, 0.1), (95, AGREEING, 1.0, 0.1), inertial_speed=1.0
        )
        is None
    )


def test_a_residual_agrees_within_three_sigma_and_the_drift():
    """Drift of 0.05 m/s² for 0.1 s, and white noise of 0.01 m/s."""
    limit = math.hypot(3 * 0.01, 0.05 * 0.1)
    for factor, expected in ((0.99, (101, 100)), (1.01, None)):
        for sign in (1.0, -1.0):
            forward = AGREEING._replace(residual=sign * factor * limit)
            assert detect_slip_end((110, forward, 1.0, 0.1), inertial_speed=1.0) == expected


@pytest.mark.parametrize(
    ("residual", "gain", "windows"),
    [(0.0, 0.02, 6), (0.01, 0.021, 5), (-0.01, 0.03, 7), (0.01, -0.02, 100), (0.0, 0.3, 5)],
)
def test_a_wheel_that_follows_the_changes_of_speed_is_trusted_at_the_significance_of_a_slip(
    residual, gain, windows
):
    """Twice the log likelihood ratio of residual + gain: spinning freely (mean 0) or following (mean: gain).

    Noise of 0.01 m/s. The sum never falls below zero, and one window contributes at most a fifth of 4.5².
    """
    following = AGREEING._replace(residual=residual, speed_gain=gain)
    ratio_per_window = min(((residual + gain) ** 2 - residual**2) / 0.01**2, 4.5**2 / 5)
    if ratio_per_window > 0.0:
        assert windows == math.ceil(4.5**2 / ratio_per_window - 1e-9)
    assert detect_slip_end((150, following, 1.0, 0.1), inertial_speed=1.0) == (1 + windows, windows)
    contradicting = AGREEING._replace(residual=0.01, speed_gain=-0.015)
    assert detect_slip_end((20, contradicting, 1.0, 0.1), (150, following, 1.0, 0.1), inertial_speed=1.0) == (
        21 + min(windows, 80),
        20 + min(windows, 80),
    )
    incomplete = (min(windows, 95) - 1, following, 1.0, 0.1)
    assert detect_slip_end(incomplete, (1, DISAGREEING, 1.0, 0.1), incomplete, inertial_speed=1.0) is None
    assert detect_slip_end((150, following, 1.0, 0.1)) is None


@pytest.mark.parametrize(
    ("inertial_speed", "slip", "sigma", "discarded"),
    [
        (3.1, -0.2, 0.1, True),
        (-3.1, 0.2, 0.1, True),
        (3.1, -0.05, 0.1, False),
        (3.1, -6.2, 0.1, False),
        (2.9, -0.2, 0.1, False),
        (0.0, 1.0, 2.99, False),
        (0.0, 1.0, 3.01, True),
        (None, 1.0, 3.01, False),
    ],
)
def test_an_inertial_speed_beyond_the_usual_speeds_is_discarded_for_a_slower_wheel(
    inertial_speed, slip, sigma, discarded
):
    """The limit is 1.5 times the maximum of 2 m/s; a sigma of that size discards the speed as well."""
    detector = SlipDetector()
    detector.start_slip(7)
    assert detector.detect_end(9, DISAGREEING, slip, sigma**2, inertial_speed, 2.0) == discarded
    assert detector.slips[-1].last == (8 if discarded else None)


def can_detect_onset(detector):
    """Return True if the detector may report a slip at once, without new agreement."""
    return any(
        detector.detect_onset(1000 + n, AGREEING._replace(residual=0.5), 2.0) is not None for n in range(15)
    )


def detector_after_rolling(windows=20):
    """Return a detector after that many windows of agreement."""
    detector = SlipDetector()
    for number in range(windows):
        assert detector.detect_onset(number, AGREEING, 2.0) is None
    return detector


def test_the_next_slip_is_detected_at_once_only_after_a_slip_that_ended_by_itself():
    assert can_detect_onset(detector_after_rolling()) and not can_detect_onset(detector_after_rolling(19))
    ended = detector_after_rolling()
    ended.start_slip(20)
    for number in range(21, 55):
        ended.detect_end(number, AGREEING, 0.0, 0.04, None, 2.0)
    assert not ended.is_slipping and can_detect_onset(ended)
    for cause in ({"number": 220}, {"number": 21, "inertial_speed": 9.0}):
        detector = detector_after_rolling()
        detector.start_slip(20)
        arguments = {
            "forward": DISAGREEING,
            "slip": -8.0,
            "variance": 0.04,
            "inertial_speed": None,
            "max_speed": 2.0,
        }
        assert detector.detect_end(**{**arguments, **cause})
        assert detector.slips[-1].last == cause["number"] - 1
        assert not can_detect_onset(detector)


def test_an_outage_ends_a_slip_and_requires_new_agreement():
    slipping, rolling = detector_after_rolling(), detector_after_rolling()
    slipping.start_slip(20)
    for detector in (slipping, rolling):
        detector.end_by_outage(45)
        assert not detector.is_slipping and not can_detect_onset(detector)
    assert [slip.last for slip in slipping.slips] == [45]
    assert rolling.slips == []


def test_a_new_slip_starts_without_the_history_of_the_last():
    detector = SlipDetector()
    for first in (0, 50):
        detector.start_slip(first)
        assert not detector.detect_end(
            first + 1, DISAGREEING._replace(speed_gain=-3.0 + 0.06 * first), LARGEST_SLIP, 0.04, 1.0, 2.0
        )
        ended = [detector.detect_end(first + n, AGREEING, 0.0, 0.04, 1.0, 2.0) for n in range(2, 40)]
        assert ended.index(True) == (4 if first == 0 else 19)


def test_a_slip_is_described_with_times_and_speed():
    detector = SlipDetector()
    detector.start_slip(12)
    slip = detector.slips[-1]
    assert slip.start == pytest.approx(1.2) and slip.end == math.inf
    assert slip.description.startswith("t = 1.2 s and on")
    slip.last, slip.speed = 34, -0.44
    assert slip.end == pytest.approx(3.5)
    assert "t = 1.2 to 3.5 s" in slip.description and "up to 0.4 m/s slower than the road" in slip.description
    slip.speed = 0.44
    assert "up to 0.4 m/s faster than the road" in slip.description
