"""Measured inputs as smooth functions: what the smoother claims about the noise it lets through is so."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from hubodo.smoothing_spline import constant_spline, fit_interpolating_spline, fit_smoothing_spline


def signal(t):
    return 1.0 + np.sin(0.7 * t) + 0.3 * np.sin(2.1 * t + 1.0)


def slope(t):
    return 0.7 * np.cos(0.7 * t) + 0.63 * np.cos(2.1 * t + 1.0)


def summed(t):
    return t - np.cos(0.7 * t) / 0.7 - np.cos(2.1 * t + 1.0) / 7.0


def noisy(seed, sigma, rate=50.0, duration=60.0, uneven=False):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / rate)
    if uneven:
        t = t + rng.uniform(-0.3, 0.3, len(t)) / rate
    return t, signal(t) + sigma * rng.standard_normal(len(t))


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize(("rate", "sigma"), [(20.0, 5e-4), (20.0, 0.05), (100.0, 5e-4), (100.0, 0.05)])
def test_the_noise_it_finds_and_the_noise_it_lets_through_are_what_it_says(rate, sigma, uneven):
    at = np.linspace(1.0, 58.5, 3000)
    found, value, rate_of_change = [], [], []
    for seed in range(12):
        made = fit_smoothing_spline(*noisy(seed, sigma, rate, uneven=uneven))
        found.append(made.noise / sigma)
        value.append(np.std(made(at) - signal(at)) / made.value_noise)
        rate_of_change.append(np.std(made(at, 1) - slope(at)) / made.slope_noise)
    assert np.mean(found) == pytest.approx(1.0, abs=0.03), "noise, seeds 0 to 11"
    assert np.mean(value) == pytest.approx(1.0, abs=0.1), "value, seeds 0 to 11"
    assert np.mean(rate_of_change) == pytest.approx(1.0, abs=0.1), "slope, seeds 0 to 11"


def test_what_is_left_of_the_noise_adds_up_over_time_as_its_memory_says():
    """The integral over T of noise of size s that is correlated over m has 1 sigma s sqrt(m T)."""
    ratios = []
    for seed in range(40):
        made = fit_smoothing_spline(*noisy(seed, 0.05))
        edges = np.linspace(5.0, 55.0, 6)
        error = np.diff(made.integral(edges)) - np.diff(summed(edges))
        ratios.extend(error / (made.value_noise * np.sqrt(made.correlation_time * 10.0)))
    assert np.std(ratios) == pytest.approx(1.0, abs=0.15), "seeds 0 to 39"


def test_noise_is_smoothed_more_than_a_signal_that_is_as_small():
    made = fit_smoothing_spline(*noisy(1, 0.05))
    assert made.value_noise < 0.4 * made.noise


def test_exact_samples_are_taken_as_they_are():
    t, value = noisy(0, 0.0)
    made = fit_smoothing_spline(t, value)
    assert np.abs(made(t) - value).max() < 1e-5
    assert made.noise < 1e-6


def test_samples_that_never_change_give_a_constant():
    made = fit_smoothing_spline(np.arange(0.0, 10.0, 0.1), np.full(100, 0.7))
    np.testing.assert_allclose(made(np.linspace(0, 9.9, 50)), 0.7, atol=1e-9)


def test_a_gap_in_the_samples_is_bridged():
    t, value = noisy(2, 1e-3)
    kept = (t < 20.0) | (t > 20.4)
    made = fit_smoothing_spline(t[kept], value[kept])
    at = np.linspace(20.0, 20.4, 50)
    assert np.abs(made(at) - signal(at)).max() < 0.05


@settings(max_examples=30)
@given(a=st.floats(0.0, 10.0), b=st.floats(0.0, 10.0))
def test_the_integral_is_that_of_the_value_and_the_slope_is_its_derivative(a, b):
    t = np.linspace(0.0, 10.0, 101)
    made = fit_interpolating_spline(t, signal(t))
    between = quad(lambda x: float(made(np.array([x]))[0]), a, b, epsabs=1e-11, limit=200)[0]
    ends = made.integral(np.array([a, b]))
    assert ends[1] - ends[0] == pytest.approx(between, abs=1e-8)
    h = 1e-4
    inner = np.clip(np.array([a]), h, 10.0 - h)
    assert made(inner, 1)[0] == pytest.approx((made(inner + h) - made(inner - h))[0] / (2 * h), abs=1e-5)


def test_before_and_after_the_ends_hold_and_slopes_are_zero():
    t = np.linspace(2.0, 4.0, 21)
    made = fit_interpolating_spline(t, t**2)
    np.testing.assert_allclose(made(np.array([0.0, 9.0])), [4.0, 16.0])
    np.testing.assert_array_equal(made(np.array([0.0, 9.0]), 1), [0.0, 0.0])
    np.testing.assert_allclose(
        made.integral(np.array([1.0, 2.0, 4.0, 5.0])), [-4.0, 0.0, 56 / 3, 56 / 3 + 16]
    )
    # The ends themselves have their slope, also where a stamp is rounded beyond them.
    np.testing.assert_allclose(made(np.array([np.nextafter(2.0, 0.0), 4.0]), 1), [4.0, 8.0])


def test_a_constant_is_known_and_does_not_change():
    made = constant_spline(0.3, 0.0, 5.0)
    assert made(np.array([-1.0, 2.0]))[1] == pytest.approx(0.3)
    assert made.integral(np.array([5.0]))[0] == pytest.approx(1.5)
    assert (made.noise, made.value_noise, made.slope_noise) == (0.0, 0.0, 0.0)


def test_too_few_samples_are_refused():
    with pytest.raises(ValueError, match="9 samples: at least 10"):
        fit_smoothing_spline(np.arange(9.0), np.zeros(9))
