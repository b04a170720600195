"""Search and tracking of a spin rate beyond the gyro range from the rotation of gravity."""

from __future__ import annotations

import cmath

import numpy as np
import pytest

from hubodo.fuse.wheel.preintegration import WindowBuilder
from hubodo.fuse.wheel.spin_search import SpinTracker, find_spin, rederotate_window
from hubodo.fuse.wheel.window import WINDOW_S, Window
from wheel_windows import LIMIT, G, R, rolling_windows

ARM, BIAS = 0.02 - 0.01j, 0.3 + 0.2j


@pytest.mark.parametrize("slope", [0.0, 30.0, -30.0])
def test_rederotating_with_excess_and_slope_equals_an_unclipped_gyro(slope: float) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(-0.05, 0.6, 1.0 / 208.0)
    gyro, accel = rng.standard_normal((2, len(t), 3))
    gyro[:, 2] += 20.0
    full_gyro = gyro.copy()
    # The excess is 7 rad/s in the middle of the window from 0.3 to 0.4 s.
    full_gyro[:, 2] += 7.0 + slope * (t - 0.35)
    clipped, unclipped = (WindowBuilder("left", 0.0, 0.1).add_many(t, w, accel)[3] for w in (gyro, full_gyro))
    rederotated = rederotate_window(clipped, 7.0, slope)
    for name in ("carrier", "force", "across", "rate_carrier", "lever"):
        # Linear interpolation between samples differs from a parabola by slope dt² / 8 at most.
        assert abs(getattr(rederotated, name) - getattr(unclipped, name)) < 3e-4 * max(
            1.0, abs(getattr(unclipped, name))
        )
    for name in ("rate_start", "rate_end"):
        assert getattr(rederotated, name) - getattr(clipped, name) == pytest.approx(
            getattr(unclipped, name) - getattr(clipped, name) - 7.0
        )
    assert rederotated.spin == clipped.spin
    without_samples = clipped._replace(samples=None)
    assert rederotate_window(without_samples, 7.0) is without_samples


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("spin", "slope"), [(34.6, 0.0), (50.13, 7.7), (90.4, 20.9), (90.4, -20.9), (130.0, 32.0), (230.0, 0.0)]
)
def test_the_search_finds_spin_rate_and_angle_at_both_ends(spin: float, slope: float, sign: float) -> None:
    windows = rolling_windows(sign * spin, sign * slope, rate_hz=208.0)[2:9]
    estimate = find_spin(windows, R)
    assert estimate is not None
    start, end = 0.2, 0.9
    for t, angle in ((start, estimate.start_angle), (end, estimate.end_angle)):
        truth = 0.4 + sign * (spin * t + 0.5 * slope * t * t)
        assert cmath.phase(cmath.exp(1j * (angle - truth))) == pytest.approx(0.0, abs=0.012)
    for middle, excess in ((start + 0.05, estimate.excess), (end - 0.05, estimate.excess_end)):
        assert excess == pytest.approx(sign * (spin + slope * middle - LIMIT), abs=0.04)


@pytest.mark.parametrize(("factor", "accepted"), [(0.64, False), (0.69, True), (1.47, True), (1.53, False)])
def test_a_rotating_force_is_accepted_from_two_thirds_to_1_5_times_gravity(
    factor: float, accepted: bool
) -> None:
    windows = rolling_windows(60.0, gravity=factor * G)[:8]
    assert (find_spin(windows, R) is not None) == accepted
    tracker = SpinTracker(R)
    tracker.initialise(60.0 - LIMIT, 0.0)
    for window in windows:
        tracker.track_window(window, 0j, 0j)
    assert tracker.is_observed == accepted


def test_the_search_needs_a_quarter_of_a_second_of_valid_samples() -> None:
    """At 104 Hz; samples of windows with a clipped force or a gap do not count."""
    windows = rolling_windows(60.0, rate_hz=104.0)
    assert find_spin(windows[:2], R) is None
    assert find_spin(windows[:3], R) is not None
    gaps = [window._replace(missing=0.1) for window in windows[2:]]
    assert find_spin([*windows[:2], *gaps], R) is None
    assert find_spin(rolling_windows(60.0, accel_limit=0.6 * G)[:8], R) is None
    assert find_spin([window._replace(samples=None) for window in windows], R) is None
    # One window with enough samples is sufficient.
    estimate = find_spin(rolling_windows(80.0, rate_hz=416.0)[4:5], R)
    assert estimate is not None and estimate.excess == pytest.approx(80.0 - LIMIT, abs=1.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("slope", "initial_error"),
    [(0.0, 6.0), (0.0, -6.0), (20.3, 0.0), (-20.3, 0.0), (31.0, 0.0), (-31.0, 0.0)],
)
def test_the_tracker_follows_gravity_corrected_for_lever_arm_and_bias(
    slope: float, initial_error: float, sign: float
) -> None:
    """It starts with a slope of zero and an excess that is wrong by as much as braking causes."""
    spin = 80.0
    windows = rolling_windows(sign * spin, sign * slope, arm=ARM, bias=BIAS, rate_hz=208.0)
    tracker = SpinTracker(R)
    tracker.initialise(sign * (spin - LIMIT) + initial_error, 0.0)
    assert not tracker.is_tracking
    for window in windows[:8]:
        tracker.track_window(window, ARM, BIAS)
        assert tracker.is_tracking
    middle = 0.75
    assert tracker.is_observed
    assert tracker.excess == pytest.approx(sign * (spin + slope * middle - LIMIT), abs=0.1)
    assert tracker.slope == pytest.approx(sign * slope, abs=0.6)
    tracker.pause()
    assert not tracker.is_tracking and not tracker.is_observed


def test_an_uncorrected_lever_arm_biases_the_tracker_while_braking() -> None:
    windows = rolling_windows(80.0, -20.0, arm=3.0 * ARM, rate_hz=208.0)
    errors = []
    for arm in (3.0 * ARM, -3.0 * ARM):
        tracker = SpinTracker(R)
        tracker.initialise(80.0 - LIMIT, -20.0)
        for window in windows[:8]:
            tracker.track_window(window, arm, 0j)
        errors.append(abs(tracker.excess - (80.0 - 20.0 * 0.75 - LIMIT)))
    assert errors[0] < 0.05 < errors[1]


def test_without_rotating_force_the_rate_is_extrapolated_with_a_decaying_slope() -> None:
    """The slope is halved in each window from the fourth on."""
    windows = rolling_windows(60.0, gravity=0.0)
    tracker = SpinTracker(R)
    tracker.initialise(20.0, 8.0)
    excess, slope = 20.0, 8.0
    for number, window in enumerate(windows[:6], start=1):
        tracker.track_window(window, 0j, 0j)
        excess += slope * WINDOW_S
        slope *= 0.5 if number >= 4 else 1.0
        assert (tracker.excess, tracker.slope, tracker.is_observed) == (
            pytest.approx(excess),
            slope,
            False,
        )
    tracker.pause()
    assert not tracker.is_tracking and tracker.excess == pytest.approx(excess)
    tracker.track_window(windows[6], 0j, 0j)
    tracker.record_unclipped(Window(rate_start=3.0, rate_end=4.5))
    assert not tracker.is_tracking and not tracker.is_observed
    assert (tracker.excess, tracker.slope) == (0.0, pytest.approx(15.0))
