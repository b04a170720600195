"""RLS against weighted least squares by QR, filterpy's fading filter, and its own limits."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from hubodo.sensors.filters.recursive_least_squares import _INITIAL_VARIANCE, RecursiveLeastSquares


def regressors(y, rates, lagged):
    before = np.append(0.0, rates[:-1])
    used = np.append(0.0, y[:-1]) if lagged else y
    return np.column_stack([np.arange(1.0, len(y) + 1), before - used])


@pytest.mark.parametrize("lagged", [False, True])
@pytest.mark.parametrize("forgetting", [1.0, 0.98, 0.92])
def test_the_coefficients_are_those_of_weighted_least_squares(forgetting, lagged):
    """numpy's lstsq (SVD) over all samples with weights lambda^(N - n), and P_0 as two more rows."""
    count = 300
    z = np.random.default_rng(2).normal(3.0, 0.3, count)
    ours = RecursiveLeastSquares(forgetting, bias=0.1, lagged=lagged)
    rates = ours.run(z)
    x = regressors(z - 0.1, rates, lagged)
    weights = forgetting ** (0.5 * np.arange(count - 1, -1, -1))
    prior = math.sqrt(forgetting**count / _INITIAL_VARIANCE) * np.eye(2)
    rows = np.vstack([weights[:, None] * x, prior])
    right = np.append(weights * (z - 0.1), [0.0, 0.0])
    expected = np.linalg.lstsq(rows, right)[0]
    # P_0 = 1e6 costs six of sixteen digits of the first steps.
    assert ours.coefficients == pytest.approx(expected, rel=1e-8)
    assert rates[-1] == pytest.approx(x[-1] @ expected, rel=1e-8)
    assert ours.covariance == pytest.approx(np.linalg.inv(rows.T @ rows), rel=1e-8)


def test_the_filter_equals_the_fading_filter_of_filterpy():
    """A Kalman filter with F = I, Q = 0, R = 1 and P / lambda ahead of each update is eq. 13-14."""
    z = np.random.default_rng(4).normal(5.0, 0.2, 200)
    theirs = KalmanFilter(2, 1)
    theirs.alpha, theirs.Q, theirs.P = 1 / math.sqrt(0.98), np.zeros((2, 2)), _INITIAL_VARIANCE * np.eye(2)
    ours, estimate = RecursiveLeastSquares(0.98), 0.0
    for n, value in enumerate(z.tolist(), 1):
        row = np.array([[float(n), estimate - value]])
        theirs.predict()
        theirs.update(value, H=row)
        estimate = float((row @ theirs.x)[0, 0])
        assert ours.update(value) == pytest.approx(estimate, rel=1e-7)


def test_white_noise_at_a_constant_rate_is_reduced_to_the_golden_ratio():
    """-b_2 = a with a^2 + a = 1; the residual variance is a times that of the noise (module docstring)."""
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    noise, seed = 0.1, 11
    count = 60_000
    # The rate is small, because the line through n = 0 leads it by 2000 / n of its value.
    z = 0.1 + np.random.default_rng(seed).normal(0.0, noise, count)
    filter_ = RecursiveLeastSquares(0.9995)
    rates = filter_.run(z)[20_000:]
    # With 2000 remembered samples the 1 sigma of b_2 is 1 / sqrt(2000 / 1.6) = 0.03 at any time.
    assert -filter_.coefficients[1] == pytest.approx(golden, abs=0.1)
    assert np.var(rates) / noise**2 == pytest.approx(golden, abs=0.03)
    other = RecursiveLeastSquares(0.9995, lagged=True).run(z)[20_000:]
    assert np.var(other) / noise**2 < 0.01


def test_the_line_through_zero_leads_a_constant_by_its_memory():
    count = 40_000
    z = 5.0 + np.random.default_rng(12).normal(0.0, 0.01, count)
    rates = RecursiveLeastSquares(0.999, lagged=True).run(z)
    # A thousand samples with noise 0.01 leave 0.0003, which is 0.002 of the lead of 0.125.
    assert rates[-1] / 5.0 - 1.0 == pytest.approx(1000 / count, rel=0.1)


def test_single_updates_equal_a_batch():
    z = np.random.default_rng(6).normal(3.0, 0.3, 500)
    live, batch = RecursiveLeastSquares(0.92), RecursiveLeastSquares(0.92)
    assert [live.update(v) for v in z.tolist()] == [*batch.run(z[:123]), *batch.run(z[123:])]
    assert live.coefficients == batch.coefficients and live.rate == batch.rate


@pytest.mark.parametrize("rate", [0.0, 0.25])
def test_hours_of_equal_samples_cause_no_overflow(rate):
    """lambda^-n would overflow after 8,500 samples at 0.92; later rates must still be followed."""
    filter_ = RecursiveLeastSquares(0.92)
    filter_.run(np.full(50_000, rate))
    assert np.isfinite(filter_.covariance).all() and np.linalg.eigvalsh(filter_.covariance)[0] >= 0.0
    noise = np.random.default_rng(1).normal(0.0, 1e-3, 500)
    rates = filter_.run(6.0 + noise)
    assert rates[-100:] == pytest.approx(np.full(100, 6.0), abs=5e-3)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-35.0, 35.0), st.floats(0.0, 0.3), st.integers(1, 400)), min_size=1, max_size=8
    ),
    st.sampled_from([0.92, 0.98, 0.999]),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_the_covariance_stays_positive_for_any_input(legs, forgetting, lagged, seed):
    rng = np.random.default_rng(seed)
    z = np.concatenate([np.round(rng.normal(rate, noise, n), 3) for rate, noise, n in legs])
    filter_ = RecursiveLeastSquares(forgetting, lagged=lagged)
    for part in np.array_split(z, 20):
        rates = filter_.run(part)
        assert np.isfinite(rates).all()
        p = filter_.covariance
        assert p[0, 0] > 0.0 and p[1, 1] > 0.0
        # Rounding may make the determinant zero, but negative only by as much as it rounds.
        assert p[0, 1] ** 2 <= p[0, 0] * p[1, 1] * (1.0 + 1e-6)


@pytest.mark.parametrize("forgetting", [0.0, -0.1, 1.0001, math.nan])
def test_another_forgetting_factor_is_refused(forgetting):
    with pytest.raises(ValueError, match="forgetting"):
        RecursiveLeastSquares(forgetting)


@pytest.mark.parametrize("samples", [[0.0, math.inf], [math.nan], [[0.0, 1.0], [2.0, 3.0]], 1.0])
def test_samples_that_are_not_one_row_of_numbers_are_refused(samples):
    filter_ = RecursiveLeastSquares(0.98)
    filter_.update(0.3)
    before = filter_.rate, filter_.coefficients
    with pytest.raises(ValueError, match="finite"):
        filter_.run(np.array(samples))
    assert (filter_.rate, filter_.coefficients) == before


@pytest.mark.parametrize("forgetting", [1e-3, 1.0])
def test_the_limits_of_the_forgetting_factor_are_accepted(forgetting):
    assert math.isfinite(RecursiveLeastSquares(forgetting).update(1.0))
