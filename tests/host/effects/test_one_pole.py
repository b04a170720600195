"""First-order low-pass filter against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.effects.one_pole import one_pole


@pytest.mark.parametrize("tau", [1e-4, 0.002, 0.02, 0.5, 20.0])
@pytest.mark.parametrize("uneven", [False, True])
def test_the_response_to_a_sine_has_the_theoretical_gain_and_phase(tau, uneven):
    """Steady part of gain 1 / sqrt(1 + (w tau)²) and phase -atan(w tau), and the decaying transient."""
    w = 7.0
    t = np.arange(0.0, 4.0, 0.005)
    if uneven:
        t = np.sort(np.random.default_rng(3).uniform(0.0, 4.0, 900))
    value, slope = np.sin(w * t + 0.4), w * np.cos(w * t + 0.4)

    def steady(x):
        return np.sin(w * x + 0.4 - np.arctan(w * tau)) / np.hypot(1.0, w * tau)

    expected = steady(t) + (value[0] - steady(t[0])) * np.exp(-(t - t[0]) / tau)
    output = one_pole(t, value[None], slope[None], tau)[0]
    # The largest deviation of a cubic through values and slopes from a sine; the filter only averages it.
    between = (w * np.diff(t).max()) ** 4 / 384
    np.testing.assert_allclose(output, expected, rtol=0, atol=between)


@given(tau=st.floats(1e-4, 1e2), gap=st.floats(1e-3, 10.0))
def test_a_ramp_is_delayed_by_the_time_constant(tau, gap):
    """y = t - tau (1 - e^(-t/tau)) for any step."""
    t = np.concatenate([np.arange(0.0, 1.0, 0.1), 1.0 + gap + np.arange(0.0, 1.0, 0.13)])
    output = one_pole(t, t[None], np.ones((1, len(t))), tau)[0]
    np.testing.assert_allclose(output, t + tau * np.expm1(-t / tau), rtol=1e-9, atol=1e-9)


@given(value=st.floats(-10, 10), tau=st.floats(1e-3, 10))
def test_a_constant_is_unchanged(value, tau):
    t = np.linspace(0.0, 3.0, 50)
    output = one_pole(t, np.full((3, 50), value), np.zeros((3, 50)), tau)
    np.testing.assert_allclose(output, value, atol=1e-10)


def test_an_invalid_time_constant_is_refused():
    for tau in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="above 0"):
            one_pole(np.arange(3.0), np.zeros((1, 3)), np.zeros((1, 3)), tau)


def test_a_single_sample_is_unchanged():
    np.testing.assert_array_equal(
        one_pole(np.zeros(1), np.full((2, 1), 5.0), np.zeros((2, 1)), 0.1), [[5.0]] * 2
    )


@pytest.mark.parametrize("ratio", [1e-4, 0.05, 0.29, 0.31, 1.0, 5.0, 40.0])
def test_the_response_to_a_cubic_is_exact_for_any_ratio_of_step_and_time_constant(ratio):
    """Gauss quadrature of the convolution integral."""
    step = 0.2
    t = np.array([0.0, step])

    def cubic(s):
        return 0.3 - 1.1 * s + 0.7 * s**2 + 2.0 * s**3

    value = cubic(t / step)
    slope = np.array([-1.1, -1.1 + 1.4 + 6.0]) / step
    here, share = np.polynomial.legendre.leggauss(80)
    s = 0.5 * (here + 1.0)
    expected = value[0] * np.exp(-ratio) + np.sum(0.5 * share * ratio * np.exp(-ratio * (1.0 - s)) * cubic(s))
    output = one_pole(t, value[None], slope[None], step / ratio)[0]
    assert output[0] == value[0]
    assert output[1] == pytest.approx(expected, rel=1e-12)
