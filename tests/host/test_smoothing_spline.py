"""Smoothing splines of measured inputs: estimated noise, residual noise, values and integrals are correct."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from hubodo.smoothing_spline import LowPass, constant_spline, fit_interpolating_spline, fit_smoothing_spline
from repetitions import first_and_more


def signal(t):
    return 1.0 + np.sin(0.7 * t) + 0.3 * np.sin(2.1 * t + 1.0)


def slope(t):
    return 0.7 * np.cos(0.7 * t) + 0.63 * np.cos(2.1 * t + 1.0)


def integral_of_signal(t):
    return t - np.cos(0.7 * t) / 0.7 - np.cos(2.1 * t + 1.0) / 7.0


def noisy_samples(seed, sigma, rate=50.0, duration=60.0, uneven=False):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / rate)
    if uneven:
        t = t + rng.uniform(-0.3, 0.3, len(t)) / rate
    return t, signal(t) + sigma * rng.standard_normal(len(t))


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize(
    ("rate", "sigma"), first_and_more((20.0, 5e-4), (20.0, 0.05), (100.0, 5e-4), (100.0, 0.05))
)
def test_estimated_noise_and_residual_noise_are_correct(rate, sigma, uneven):
    times = np.linspace(1.0, 58.5, 3000)
    estimates, value, rate_of_change = [], [], []
    for seed in range(12):
        spline = fit_smoothing_spline(*noisy_samples(seed, sigma, rate, uneven=uneven))
        estimates.append(spline.noise / sigma)
        value.append(np.std(spline(times) - signal(times)) / spline.value_noise)
        rate_of_change.append(np.std(spline(times, 1) - slope(times)) / spline.slope_noise)
    assert np.mean(estimates) == pytest.approx(1.0, abs=0.03), "noise, seeds 0 to 11"
    assert np.mean(value) == pytest.approx(1.0, abs=0.1), "value, seeds 0 to 11"
    assert np.mean(rate_of_change) == pytest.approx(1.0, abs=0.1), "slope, seeds 0 to 11"


def test_the_integral_of_the_residual_noise_grows_by_its_correlation_time():
    """Noise of standard deviation s and correlation time m integrates over T to s sqrt(m T) (1 sigma)."""
    ratios = []
    for seed in range(40):
        spline = fit_smoothing_spline(*noisy_samples(seed, 0.05))
        edges = np.linspace(5.0, 55.0, 6)
        error = np.diff(spline.integral(edges)) - np.diff(integral_of_signal(edges))
        ratios.extend(error / (spline.value_noise * np.sqrt(spline.correlation_time * 10.0)))
    assert np.std(ratios) == pytest.approx(1.0, abs=0.15), "seeds 0 to 39"


def test_smoothing_reduces_the_noise():
    spline = fit_smoothing_spline(*noisy_samples(1, 0.05))
    assert spline.value_noise < 0.4 * spline.noise


def test_exact_samples_are_interpolated():
    t, value = noisy_samples(0, 0.0)
    spline = fit_smoothing_spline(t, value)
    assert np.abs(spline(t) - value).max() < 1e-5
    assert spline.noise < 1e-6


def test_samples_that_never_change_give_a_constant():
    spline = fit_smoothing_spline(np.arange(0.0, 10.0, 0.1), np.full(100, 0.7))
    np.testing.assert_allclose(spline(np.linspace(0, 9.9, 50)), 0.7, atol=1e-9)


def test_a_gap_in_the_samples_is_bridged():
    t, value = noisy_samples(2, 1e-3)
    has_sample = (t < 20.0) | (t > 20.4)
    spline = fit_smoothing_spline(t[has_sample], value[has_sample])
    times = np.linspace(20.0, 20.4, 50)
    assert np.abs(spline(times) - signal(times)).max() < 0.05


@settings(max_examples=30)
@given(a=st.floats(0.0, 10.0), b=st.floats(0.0, 10.0))
def test_the_integral_is_that_of_the_value_and_the_slope_is_its_derivative(a, b):
    t = np.linspace(0.0, 10.0, 101)
    spline = fit_interpolating_spline(t, signal(t))
    between = quad(lambda x: float(spline(np.array([x]))[0]), a, b, epsabs=1e-11, limit=200)[0]
    ends = spline.integral(np.array([a, b]))
    assert ends[1] - ends[0] == pytest.approx(between, abs=1e-8)
    h = 1e-4
    inner = np.clip(np.array([a]), h, 10.0 - h)
    assert spline(inner, 1)[0] == pytest.approx(
        (spline(inner + h) - spline(inner - h))[0] / (2 * h), abs=1e-5
    )


def test_outside_the_samples_the_end_values_hold_and_slopes_are_zero():
    t = np.linspace(2.0, 4.0, 21)
    spline = fit_interpolating_spline(t, t**2)
    np.testing.assert_allclose(spline(np.array([0.0, 9.0])), [4.0, 16.0])
    np.testing.assert_array_equal(spline(np.array([0.0, 9.0]), 1), [0.0, 0.0])
    np.testing.assert_allclose(
        spline.integral(np.array([1.0, 2.0, 4.0, 5.0])), [-4.0, 0.0, 56 / 3, 56 / 3 + 16]
    )
    # The slope at an end is that of the spline, even if rounding, or the step of a numerical derivative, puts
    # the time just outside.
    np.testing.assert_allclose(spline(np.array([np.nextafter(2.0, 0.0), 4.0]), 1), [4.0, 8.0])
    np.testing.assert_allclose(spline(np.array([2.0 - 1e-8, 4.0 + 1e-7]), 1), [4.0, 8.0])


def test_a_constant_is_known_and_does_not_change():
    spline = constant_spline(0.3, 0.0, 5.0)
    assert spline(np.array([-1.0, 2.0]))[1] == pytest.approx(0.3)
    assert spline.integral(np.array([5.0]))[0] == pytest.approx(1.5)
    assert (spline.noise, spline.value_noise, spline.slope_noise) == (0.0, 0.0, 0.0)


def test_too_few_samples_are_refused():
    with pytest.raises(ValueError, match="9 samples: at least 10"):
        fit_smoothing_spline(np.arange(9.0), np.zeros(9))


@pytest.mark.parametrize("cutoff", [1.0, 4.0, 20.0])
def test_a_tone_at_the_largest_frequency_passes_half(cutoff):
    t = np.arange(0.0, 20.0, 0.01)
    tone = np.sin(2.0 * np.pi * cutoff * t)
    passed = fit_smoothing_spline(t, tone, max_frequency=cutoff)(t)
    inside = slice(500, 1500)
    assert passed[inside] @ tone[inside] / (tone[inside] @ tone[inside]) == pytest.approx(0.5, abs=0.05)


def test_a_largest_frequency_beyond_the_band_of_white_noise_changes_nothing():
    t, value = noisy_samples(3, 0.05)
    assert np.array_equal(fit_smoothing_spline(t, value, 20.0)(t), fit_smoothing_spline(t, value)(t))


def test_a_low_pass_removes_from_other_samples_what_the_smoother_removed():
    t, value = noisy_samples(3, 0.001)
    spline = fit_smoothing_spline(t, value, 1.0)
    error = 0.1 * np.sin(2.0 * np.pi * 1.3 * t)
    with_error = fit_smoothing_spline(t, value + error, 1.0)
    passed = LowPass(t, spline.cutoff).apply(error)
    assert np.std(passed) < 0.5 * np.std(error)
    np.testing.assert_allclose(passed, with_error(t) - spline(t), atol=0.02 * np.std(error))


def test_a_low_pass_has_the_same_cut_off_at_another_rate_and_returns_what_is_slow():
    t = np.arange(0.0, 20.0, 0.02)
    tone, slow = np.sin(2.0 * np.pi * 2.0 * t), 0.01 * t**2
    low_pass, inside = LowPass(t, 2.0), slice(250, 750)
    passed = low_pass.apply(tone)
    assert passed[inside] @ tone[inside] / (tone[inside] @ tone[inside]) == pytest.approx(0.5, abs=0.05)
    assert low_pass.apply(slow) is slow
    assert LowPass(t, np.inf).apply(tone) is tone
