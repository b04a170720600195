"""Corrections of the motion: delayed stamps, extra speed, and a correction of a measured speed."""

import numpy as np
import pytest

from hubodo.model.inputs import BodyMotion, DelayedMotion, ExtraSpeed, SpeedCorrection

T = np.linspace(0.0, 6.0, 301)


def swaying(t):
    """v = 1.2 + 0.4 sin 0.9 t, r = 0.3 cos 0.7 t, with their integrals and derivatives."""
    v, r = 0.9 * t, 0.7 * t
    return BodyMotion(
        t=t,
        speed=1.2 + 0.4 * np.sin(v),
        acceleration=0.36 * np.cos(v),
        jerk=-0.324 * np.sin(v),
        distance=1.2 * t + 0.4 / 0.9 * (1.0 - np.cos(v)),
        yaw_rate=0.3 * np.cos(r),
        yaw_acceleration=-0.21 * np.sin(r),
        yaw_jerk=-0.147 * np.cos(r),
        heading=0.3 / 0.7 * np.sin(r),
        temperature=np.full(len(t), 25.0),
        supply=np.full(len(t), 3.7),
    )


MOTION = ("speed", "acceleration", "distance", "yaw_rate", "yaw_acceleration", "heading")


def shifted(body, by):
    return {name: getattr(body, name) + by.get(name, 0.0) for name in MOTION}


@pytest.mark.parametrize("by", [0.01, -0.01])
def test_delayed_stamps_have_the_earlier_motion(by):
    """The error is of second order in the delay."""
    late, before = DelayedMotion(by).apply(swaying(T)), swaying(T - by)
    for name in MOTION:
        off = np.abs(getattr(late, name) - getattr(before, name)).max()
        change = np.abs(getattr(swaying(T), name) - getattr(before, name)).max()
        assert off < 3e-5 < 0.05 * change, name
    assert late.jerk is not None and np.array_equal(late.t, T)


def test_extra_speed_changes_speed_and_acceleration_only():
    body = swaying(T)
    corrected = ExtraSpeed(0.3, -0.2).apply(body)
    for name, value in shifted(body, {"speed": 0.3, "acceleration": -0.2}).items():
        np.testing.assert_allclose(getattr(corrected, name), value, rtol=1e-12)


def test_an_inner_correction_is_applied_first():
    body = swaying(T)
    pushed = ExtraSpeed(0.3, -0.2)
    for last in (DelayedMotion(0.5, pushed), ExtraSpeed(0.1, 0.05, pushed)):
        plain = type(last)(*([0.5] if isinstance(last, DelayedMotion) else [0.1, 0.05]))
        one, two = last.apply(body), plain.apply(pushed.apply(body))
        for name in MOTION:
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert not np.allclose(
        DelayedMotion(0.5, pushed).apply(body).distance, DelayedMotion(0.5).apply(body).distance
    )


UNEVEN = np.cumsum(np.random.default_rng(4).uniform(0.01, 0.03, 400))
CORRECTION = SpeedCorrection(UNEVEN, 0.2 * np.sin(2.0 * UNEVEN))


def test_a_correction_of_the_speed_has_its_derivative_and_its_integral():
    inner = slice(1, -1)
    np.testing.assert_allclose(CORRECTION.acceleration[inner], 0.4 * np.cos(2.0 * UNEVEN)[inner], atol=2e-3)
    distance = 0.1 * (np.cos(2.0 * UNEVEN[0]) - np.cos(2.0 * UNEVEN))
    np.testing.assert_allclose(CORRECTION.distance, distance, atol=1e-4)
    assert CORRECTION.distance[0] == 0.0


@pytest.mark.parametrize("first", [0, 1, 150])
@pytest.mark.parametrize("count", [1, 50, 250])
def test_a_correction_is_exact_at_its_sample_times(first, count):
    part = slice(first, first + count)
    for interpolated, column in zip(CORRECTION.at(UNEVEN[part]), own(), strict=True):
        np.testing.assert_array_equal(interpolated, column[part])


def own():
    return CORRECTION.speed, CORRECTION.acceleration, CORRECTION.distance


@pytest.mark.parametrize(
    ("start", "end"), [(-0.5, 9.5), (0.005, 1.0), (2.0, 2.1), (UNEVEN[7], 5.0), (7.0, 9.0)]
)
def test_at_other_times_a_correction_is_interpolated_linearly(start, end):
    t = np.linspace(start, end, 123)
    for interpolated, column in zip(CORRECTION.at(t), own(), strict=True):
        np.testing.assert_array_equal(interpolated, np.interp(t, UNEVEN, column))
    # A single time that is not among those of the inputs.
    shifted = UNEVEN[20:60].copy()
    shifted[-1] += 1e-3
    np.testing.assert_array_equal(CORRECTION.at(shifted)[2], np.interp(shifted, UNEVEN, CORRECTION.distance))


def test_a_corrected_speed_corrects_acceleration_and_distance():
    body = swaying(T)
    speed, acceleration, distance = CORRECTION.at(T)
    corrected = CORRECTION.apply(body)
    by = {"speed": speed, "acceleration": acceleration, "distance": distance}
    for name, value in shifted(body, by).items():
        np.testing.assert_array_equal(getattr(corrected, name), value)
