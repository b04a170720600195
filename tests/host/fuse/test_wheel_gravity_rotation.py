"""Rotation of gravity in a few windows, with both accelerometer axes in range and with one of them."""

from __future__ import annotations

import cmath

import numpy as np
import pytest

from hubodo.fuse.wheel.gravity_rotation import GravitySamples
from hubodo.fuse.wheel.single_axis_gravity import SingleAxisSamples
from hubodo.fuse.wheel.spin_search import SpinTracker, find_spin
from wheel_windows import LIMIT, G, R, rolling_windows

ARM, BIAS = 0.02 - 0.01j, 0.3 + 0.2j


@pytest.mark.parametrize("spin", [35.0, 60.0])
@pytest.mark.parametrize("axes", [(True, True), (True, False), (False, True)])
def test_the_chirp_amplitude_equals_the_least_squares_fit_with_bias_and_lever_arm(
    spin: float, axes: tuple[bool, bool]
) -> None:
    """The rotation may be so small that a polynomial of time absorbs a part of it."""
    collected = GravitySamples.from_windows(rolling_windows(spin, rate_hz=208.0, bias=BIAS, arm=ARM)[3:5])
    assert collected is not None
    complete, in_range = collected
    in_range = in_range & np.array(axes)
    samples = complete if all(axes) else SingleAxisSamples.from_samples(complete, in_range)
    assert samples is not None
    chirp = samples.remove_polynomial(3).fit_chirp(np.array([spin - LIMIT]), np.zeros(1))
    phase = complete.carrier_angle + (spin - LIMIT) * complete.t
    cos, sin, powers = np.cos(phase), np.sin(phase), complete.t[:, None] ** np.arange(3)
    rows, values = [], []
    for used, by_a, by_b, value, place in (
        (axes[0], cos, sin, complete.force.real, 0),
        (axes[1], -sin, cos, complete.force.imag, 3),
    ):
        own = np.zeros((len(cos), 6))
        own[:, place : place + 3] = powers
        rows.append(used * np.column_stack([by_a, by_b, own]))
        values.append(used * value)
    fitted = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0]
    assert abs(complex(fitted[0], fitted[1])) == pytest.approx(G)
    assert chirp.amplitude == pytest.approx(complex(fitted[0], fitted[1]))


@pytest.mark.parametrize("arm", [0.15 + 0j, 0.15j])
@pytest.mark.parametrize(("spin", "slope"), [(60.0, 0.0), (90.4, 20.9), (116.0, -8.0)])
def test_one_axis_shows_spin_rate_and_angle_while_the_other_is_saturated(
    spin: float, slope: float, arm: complex
) -> None:
    """An arm of 15 cm: 540 m/s² on its axis at 60 rad/s, beyond 16 g."""
    windows = rolling_windows(spin, slope, rate_hz=208.0, arm=arm, bias=BIAS, accel_limit=16.0 * G)[2:9]
    assert all(window.force_clipped > 0.9 for window in windows)
    estimate = find_spin(windows, R)
    assert estimate is not None
    truth = 0.4 + spin * 0.9 + 0.5 * slope * 0.9**2
    assert cmath.phase(cmath.exp(1j * (estimate.end_angle - truth))) == pytest.approx(0.0, abs=0.03)
    assert estimate.excess_end == pytest.approx(spin + slope * 0.85 - LIMIT, abs=0.1)
    tracker = SpinTracker(R)
    tracker.initialise(spin + slope * 0.15 - LIMIT, 0.0)
    for window in windows:
        tracker.track_window(window, arm, BIAS)
    assert tracker.is_observed and tracker.gravity_angle is not None
    assert tracker.excess == pytest.approx(spin + slope * 0.85 - LIMIT, abs=0.1)
    middle = 0.4 + spin * 0.85 + 0.5 * slope * 0.85**2
    assert cmath.phase(cmath.exp(1j * (tracker.gravity_angle - middle))) == pytest.approx(0.0, abs=0.03)


def test_the_search_returns_none_with_both_axes_saturated_or_in_noise() -> None:
    windows = rolling_windows(90.0, rate_hz=208.0, arm=0.1 + 0.1j, accel_limit=16.0 * G)[2:9]
    assert find_spin(windows, R) is None
    rng = np.random.default_rng(7)
    detections = 0
    for _ in range(20):
        noisy = []
        for window in rolling_windows(60.0, rate_hz=104.0, gravity=0.0)[2:6]:
            assert window.samples is not None
            count = len(window.samples.force)
            noise = 12.0 * rng.standard_normal(count)
            samples = window.samples._replace(force=tuple((1j * noise).tolist()), x_in_range=(False,) * count)
            noisy.append(window._replace(samples=samples, force_clipped=1.0))
        detections += find_spin(noisy, R) is not None
    assert detections == 0, "seed 7"
