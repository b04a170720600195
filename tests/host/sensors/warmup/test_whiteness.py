"""Whiteness tests and the effect of a low-pass on means, against independent implementations."""

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.signal import lfilter
from scipy.stats import binom, chi2, norm

from hubodo.errors import InputError
from hubodo.sensors.heading.standstill import _bandwidth_reduction, estimate_angle_random_walk
from hubodo.sensors.warmup.whiteness import autocorrelation_test, ljung_box


@pytest.mark.parametrize("count, lags", [(16, 3), (60, 12), (101, 20), (500, 20)])
def test_ljung_box_is_the_formula_of_1978_about_the_mean(count, lags):
    noise = 3.0 + np.random.default_rng(count).normal(size=count)
    result = ljung_box(noise)
    off = noise - np.mean(noise)
    r = [sum(off[i] * off[i - k] for i in range(k, count)) / sum(off**2) for k in range(1, lags + 1)]
    statistic = count * (count + 2) * sum(value**2 / (count - k) for k, value in enumerate(r, 1))
    assert result.lags == lags and result.statistic == pytest.approx(statistic)
    assert result.p_value == pytest.approx(chi2.sf(statistic, lags))
    assert ljung_box(noise, 2).statistic < result.statistic and ljung_box(noise, 2).lags == 2


@pytest.mark.parametrize("sequences, length", [(1, 16), (4, 50), (10, 200)])
def test_the_autocorrelation_test_counts_lags_beyond_two_standard_errors(sequences, length):
    noise = np.random.default_rng(length).normal(size=sequences * length)
    noise[1:] += 0.3 * noise[:-1]
    result = autocorrelation_test(noise, sequences, length)
    parts = noise.reshape(sequences, length)
    r = [np.mean([(row[: length - k] @ row[k:]) / length for row in parts]) for k in range(length)]
    one = 1 / np.sqrt(sequences * length)
    assert result.autocorrelation == pytest.approx(np.array(r[1:]) / r[0]) and result.standard_error == one
    # A lag k has N - k products: the biased estimate is narrower by that factor, and the last tenth is not
    # judged.
    own = [one * np.sqrt(1 - k / length) for k in range(1, length)]
    judged = [k for k in range(1, length) if k <= 0.9 * length]
    beyond = sum(abs(r[k] / r[0]) > 2 * own[k - 1] for k in judged)
    assert result.p_value == pytest.approx(binom.sf(beyond - 1, len(judged), 2 * norm.sf(2)))
    inside = [np.mean(np.abs(r[1:]) / r[0] <= times * one) for times in (1, 2)]
    assert [result.share_within_one_sigma, result.share_within_two_sigma] == pytest.approx(inside)
    expected = [np.mean([1 - 2 * norm.sf(times * one / sigma) for sigma in own]) for times in (1, 2)]
    assert [result.expected_share_within_one_sigma, result.expected_share_within_two_sigma] == pytest.approx(
        expected
    )


@pytest.mark.parametrize(
    "count, sequences, length", [(450, 2, 200), (399, 1, 200), (100, 1, 100), (5000, 10, 200)]
)
def test_short_residuals_are_split_into_as_many_disjoint_sequences_as_fit(count, sequences, length):
    result = autocorrelation_test(np.random.default_rng(1).normal(size=count))
    assert (result.sequences, result.length) == (sequences, length)


@pytest.mark.parametrize("test", [ljung_box, autocorrelation_test])
def test_sixteen_samples_that_differ_are_the_least(test):
    noise = np.random.default_rng(1).normal(size=16)
    test(noise)
    for few in (noise[:15], np.ones(100)):
        with pytest.raises(InputError, match=f"there are {len(few)}"):
            test(few)


@pytest.mark.parametrize("pole, tau", [(0.05, 1.0), (0.3, 1.0), (0.05, 0.5)])
def test_noise_behind_a_pole_makes_neighbouring_means_differ_less_as_its_integrals_say(pole, tau):
    """Variance of a mean minus its covariance with the next, for the correlation e^(-|u - v| / T) / 2T."""
    step = 0.01
    noise = lfilter([1.0], [1.0, -np.exp(-step / pole)], np.random.default_rng(2).normal(size=500_000))

    def mean_of(start):
        correlation = lambda u, v: np.exp(-abs(u - v) / pole) / (2 * pole)  # noqa: E731
        return dblquad(correlation, 0.0, tau, start, start + tau, epsabs=1e-4)[0] / tau

    expected = 1.0 - (mean_of(0.0) - mean_of(tau))
    spans = [(0, 100), (100, len(noise) - 50), (len(noise) - 50, len(noise))]
    assert _bandwidth_reduction(noise + 5.0, spans, step, tau) == pytest.approx(expected, rel=0.05)


def test_white_noise_is_not_corrected_and_corrections_are_at_most_one_half():
    rng = np.random.default_rng(3)
    assert _bandwidth_reduction(rng.normal(size=10_000), [(0, 10_000)], 0.01, 1.0) == 0.0
    assert _bandwidth_reduction(np.ones(100), [(0, 100)], 0.01, 1.0) == 0.0
    assert _bandwidth_reduction(np.cumsum(rng.normal(size=10_000)), [(0, 10_000)], 0.01, 1.0) == 0.5


@pytest.mark.parametrize("pole", [0.0, 0.05, 0.15])
@pytest.mark.parametrize("step", [0.01, 0.02])
def test_the_white_noise_of_rests_is_the_density_at_low_frequency_whatever_the_low_pass(pole, step):
    """A one-pole low-pass leaves slow changes unchanged; between rests the bias may have changed."""
    n, count = 3e-4, 200_000
    share = np.exp(-step / pole) if pole else 0.0
    built = np.random.default_rng(4).normal(0.0, n / np.sqrt(step), count)
    rate = lfilter([1.0 - share], [1.0, -share], built)
    rate[count // 3 :] += 0.1
    t = 7.0 + step * np.arange(count)
    spans = [(0, count // 3), (count // 3, count // 2), (count // 2 + 5000, count)]
    # Some 3,000 means: their differences determine a sigma to two per cent.
    assert estimate_angle_random_walk(t, rate, spans) == pytest.approx(n, rel=0.06, abs=0.0)
    assert estimate_angle_random_walk(t, rate * 0.0, spans) is None
    assert estimate_angle_random_walk(t, rate, []) is None


@pytest.mark.parametrize("samples, reported", [(15, False), (16, True)])
def test_sixteen_means_are_the_least_and_short_rests_have_shorter_ones(samples, reported):
    noise = np.random.default_rng(5).normal(size=samples)
    result = estimate_angle_random_walk(0.01 * np.arange(samples), noise, [(0, samples)])
    assert (result is not None) == reported
    if reported:
        # One sample per mean: the Allan deviation of a sample, as far as it is white.
        assert result == pytest.approx(np.sqrt(np.mean(np.diff(noise) ** 2) / 2 * 0.01))
