"""The constant-gain filter against the matrix exponential, the Riccati equation and filterpy's recursion."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are

from hubodo.sensors.filters.rate_bias_kalman import (
    KalmanGain,
    RateBiasKalman,
    discretise,
    riccati_gain,
    steady_state_gain,
)

GAINS = st.floats(1e-6, 1e3)


@given(GAINS, st.floats(0.0, 1e3), st.floats(1e-4, 0.1))
def test_the_closed_form_is_the_matrix_exponential_and_its_integral(k1, k2, dt):
    """scipy.linalg.expm of the augmented matrix [[-M, k], [0, 0]] T contains both (Van Loan)."""
    transition, drive = discretise(KalmanGain(k1, k2), dt)
    k = np.array([k1, k2])
    augmented = np.zeros((3, 3))
    augmented[:2, :2], augmented[:2, 2] = -np.outer(k, [1.0, 1.0]), k
    expected = expm(augmented * dt)
    # Squaring in expm loses |M T| eps.
    loss = 1e-15 * (10.0 + (k1 + k2) * dt)
    assert transition == pytest.approx(expected[:2, :2], rel=0, abs=loss)
    assert drive == pytest.approx(expected[:2, 2], rel=1e-11, abs=loss)


def test_the_closed_form_is_equation_11_with_the_eigenvectors():
    k1, k2, dt = 3.0, 0.2, 0.01
    s = np.array([[k1, 1.0], [k2, -1.0]])
    total = k1 + k2
    integral = s @ np.diag([-math.expm1(-total * dt) / total * 1.0, dt]) @ np.linalg.inv(s)
    assert discretise(KalmanGain(k1, k2), dt)[1] == pytest.approx(integral @ [k1, k2], rel=1e-12)


def test_rate_and_bias_are_observable_only_through_their_sum():
    f, h = np.zeros((2, 2)), np.array([[1.0, 1.0]])
    assert np.linalg.matrix_rank(np.vstack([h, h @ f])) == 1
    # The filter shows it as well: equal sums at the start give equal innovations for ever, at any bias.
    z = np.random.default_rng(3).normal(1.0, 0.1, 500)
    one = RateBiasKalman(KalmanGain(4.0, 0.1), 0.01, rate=0.0, bias=0.3).run(z)
    other = RateBiasKalman(KalmanGain(4.0, 0.1), 0.01, rate=0.5, bias=-0.2).run(z)
    assert one.rate + one.bias == pytest.approx(other.rate + other.bias, abs=1e-14)
    assert one.bias - other.bias == pytest.approx(np.full(500, 0.5), abs=1e-14)


@given(st.floats(1e-4, 1.0), st.floats(0.0, 1.0), st.floats(1e-3, 1.0))
def test_the_steady_gain_solves_the_riccati_equation_of_the_sum(rate_step, bias_step, noise):
    """scipy solves the scalar s = rate + bias; the split is q_w : q_b, because K - K H K grows only by Q."""
    q_w, q_b, q_n = rate_step**2, bias_step**2, noise**2
    on_rate, on_bias = riccati_gain(q_w, q_b, q_n)
    ahead = solve_discrete_are(np.eye(1), np.eye(1), np.array([[q_w + q_b]]), np.array([[q_n]]))[0, 0]
    # The recursion stops when a step changes K by 1e-12; steps shrink by (1 - K)^2, so 1e-12 / K remains.
    left = 1e-12 / (on_rate + on_bias)
    assert on_rate + on_bias == pytest.approx(ahead / (ahead + q_n), rel=1e-9 + left)
    assert on_bias * q_w == pytest.approx(on_rate * q_b, rel=1e-9, abs=1e-30)


def test_the_filter_equals_the_matrix_recursion_of_filterpy_at_steady_gain():
    rate_step, bias_step, noise, dt = 0.02, 1e-3, 0.1, 0.01
    z = np.random.default_rng(5).normal(2.0, 0.3, 600)
    theirs = KalmanFilter(2, 1)
    theirs.H, theirs.R = np.array([[1.0, 1.0]]), np.array([[noise**2]])
    theirs.Q, theirs.P = np.diag([rate_step**2, bias_step**2]), np.diag([rate_step**2, bias_step**2])
    for value in z[:300]:
        theirs.predict()
        theirs.update(value)
    ours = RateBiasKalman(
        steady_state_gain(rate_step, bias_step, noise, dt), dt, rate=theirs.x[0, 0], bias=theirs.x[1, 0]
    )
    for value in z[300:]:
        theirs.predict()
        theirs.update(value)
        ours.update(value)
        assert (ours.rate, ours.bias) == pytest.approx(tuple(theirs.x[:, 0]), rel=1e-9)
    # In eq. 8 P grows without end along [1, -1] by (q_w q_b) / (q_w + q_b) per sample in each entry.
    growth = rate_step**2 * bias_step**2 / (rate_step**2 + bias_step**2)
    assert theirs.P[1, 1] > 500 * growth


def test_the_gain_per_sample_satisfies_the_riccati_recursion():
    for value, wanted in zip(
        steady_state_gain(0.02, 1e-3, 0.1, 0.01).per_sample(0.01), riccati_gain(4e-4, 1e-6, 1e-2), strict=True
    ):
        assert value == pytest.approx(wanted, rel=1e-12)


@given(st.integers(0, 400), st.integers(0, 2**32 - 1))
def test_a_batch_equals_the_live_filter(cut, seed):
    """Both take two multiplications and an addition per sample; a fused operation rounds once less."""
    z = np.random.default_rng(seed).normal(3.0, 1.0, 400)
    gain = KalmanGain(7.0, 0.01)
    live, batch = RateBiasKalman(gain, 0.01, bias=0.02), RateBiasKalman(gain, 0.01, bias=0.02)
    rates = [(live.update(value), live.bias) for value in z.tolist()]
    parts = [batch.run(z[:cut]), batch.run(z[cut:])]
    built = np.column_stack(
        [np.concatenate([p.rate for p in parts]), np.concatenate([p.bias for p in parts])]
    )
    # One rounding of s persists for 1 / K = 15 samples.
    assert np.abs(built - rates).max() <= 15 * np.spacing(8.0)
    assert (batch.rate, batch.bias) == (built[-1, 0], built[-1, 1])


@pytest.mark.parametrize("gain", [(0.0, 1.0), (-1.0, 0.0), (1.0, -1e-9), (math.nan, 0.0), (math.inf, 0.0)])
def test_an_invalid_gain_is_refused(gain):
    with pytest.raises(ValueError, match="gain"):
        KalmanGain(*gain)


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match="dt"):
        RateBiasKalman(KalmanGain(1.0, 0.0), 0.0)
    with pytest.raises(ValueError, match="rate_step"):
        steady_state_gain(0.0, 1e-3, 0.1, 0.01)
    with pytest.raises(ValueError, match="finite"):
        RateBiasKalman(KalmanGain(1.0, 0.0), 0.01).run(np.array([1.0, math.nan]))
