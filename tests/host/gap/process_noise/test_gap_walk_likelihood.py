"""A random walk in white noise, against a dense multivariate normal density."""

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.stats import multivariate_normal

from hubodo.gap.process_noise.walk_likelihood import smooth_walk, walk_log_likelihoods


def test_likelihood_ratios_match_those_of_the_dense_covariance():
    rng = np.random.default_rng(7)
    steps, variance = rng.uniform(0.5, 1.5, 19), rng.uniform(0.5, 2.0, 20)
    observed = rng.standard_normal(20).cumsum()
    times = np.concatenate([[0.0], np.cumsum(steps)])
    intensities, starts = np.array([0.1, 2.0]), np.array([1.0, 3.0])
    log_likelihoods = walk_log_likelihoods(observed, variance, steps, intensities, starts)
    dense = [
        multivariate_normal(
            np.zeros(20), np.diag(variance) + start + q * np.minimum.outer(times, times)
        ).logpdf(observed)
        for q, start in zip(intensities, starts, strict=True)
    ]
    assert log_likelihoods[1] - log_likelihoods[0] == pytest.approx(dense[1] - dense[0])


def test_a_walk_of_zero_intensity_is_smoothed_to_the_mean_and_a_large_one_to_the_observations():
    observed, variance, steps = np.array([1.0, 2.0, 6.0]), np.ones(3), np.ones(2)
    np.testing.assert_allclose(smooth_walk(observed, variance, steps, 1e-9), 3.0, atol=1e-4)
    np.testing.assert_allclose(smooth_walk(observed, variance, steps, 1e9), observed, atol=1e-4)


def test_trends_of_unknown_size_are_integrated_out():
    """The reference is the dense density of combinations of the observations that contain no trend."""
    rng = np.random.default_rng(8)
    steps, variance = rng.uniform(0.5, 1.5, 14), rng.uniform(0.5, 2.0, 15)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    trends = np.stack([times, np.sin(times)])
    observed = rng.standard_normal(15).cumsum()
    intensities, starts = np.array([0.1, 2.0]), np.array([1.0, 3.0])
    log_likelihoods = walk_log_likelihoods(observed, variance, steps, intensities, starts, trends)
    contrasts = null_space(trends).T
    dense = []
    for q, start in zip(intensities, starts, strict=True):
        covariance = np.diag(variance) + start + q * np.minimum.outer(times, times)
        contrast_covariance = contrasts @ covariance @ contrasts.T
        dense.append(multivariate_normal(np.zeros(13), contrast_covariance).logpdf(contrasts @ observed))
    assert log_likelihoods[1] - log_likelihoods[0] == pytest.approx(dense[1] - dense[0])
    with_trend = observed + 5.0 * trends[0] - 3.0 * trends[1]
    shifted = walk_log_likelihoods(with_trend, variance, steps, intensities, starts, trends)
    np.testing.assert_allclose(shifted, log_likelihoods)
