"""Marginal likelihood of the warm-up forms, against the densities of scipy."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hubodo.sensors.warmup.forms import _posterior, _ScaledRecord, factorise

SEED = 5


def test_the_marginal_likelihood_is_the_density_of_all_that_could_have_been_read():
    """Parameters are N(0, spread²) and the noise has any covariance, so the data are Gaussian, too."""
    rng = np.random.default_rng(SEED)
    columns, spread = rng.standard_normal((12, 3)), np.array([0.5, 2.0, 30.0])
    root = rng.standard_normal((12, 12))
    noise = root @ root.T + np.eye(12)
    y = rng.standard_normal(12)
    mean, covariance, reported = _posterior(columns, spread, factorise(noise.copy()), y)
    prior = np.diag(spread**2)
    whole = columns @ prior @ columns.T + noise
    assert reported == pytest.approx(multivariate_normal.logpdf(y, cov=whole))
    gain = prior @ columns.T @ np.linalg.inv(whole)
    assert mean == pytest.approx(gain @ y)
    assert covariance == pytest.approx(prior - gain @ columns @ prior)


def test_the_covariance_of_a_record_is_that_of_its_three_noises_together():
    rng = np.random.default_rng(SEED)
    flicker, walk = (root @ root.T for root in rng.standard_normal((2, 6, 6)))
    record = _ScaledRecord(np.arange(6.0), np.zeros(6), None, 1, 1.0, 0.0, flicker, walk)
    lower = np.tril(record.factor(*np.log([0.7, 2.0, 3.0]))[0])
    assert lower @ lower.T == pytest.approx(0.7**2 * np.eye(6) + 2.0**2 * flicker + 3.0**2 * walk)
