"""Recommended north programmes, ergodicity, and narrow posterior peaks."""

from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.sensors.north import advice
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.likelihood import _refine_grid
from hubodo.sensors.north.programme import (
    find_best_programme,
    find_shortest_programme,
    fit_ergodicity,
    programme_sigma,
    white_noise_azimuth_bound,
)


def test_independent_estimates_have_slope_minus_one_half_and_drifting_ones_do_not():
    rng = np.random.default_rng(2)
    good = fit_ergodicity(rng.standard_normal(1799), neighbours_overlap=False)
    assert abs(good.slope + 0.5) < 3 * good.sigma and good.sigma < 0.1
    noise = rng.standard_normal(1800)
    neighbours = fit_ergodicity((noise[1:] + noise[:-1]) / 2)
    assert abs(neighbours.slope + 0.5) < 3 * neighbours.sigma
    bad = fit_ergodicity(np.cumsum(rng.standard_normal(1799)))
    assert not bad.is_ergodic and bad.slope > 0
    assert fit_ergodicity(rng.standard_normal(10)) is None


def test_the_slope_after_drift_between_stops_is_fitted_to_means_of_four_or_more():
    """64 estimates: means of 4, 8 and 16 of them, at most a quarter of all."""
    rng = np.random.default_rng(5)
    assert fit_ergodicity(rng.standard_normal(64)).factors.tolist() == [4, 8, 16]


def test_what_a_minute_can_do_at_best_is_the_bound_of_its_white_noise():
    """Even coverage: sqrt(2 / T) N / horizontal Earth rate."""
    drift, horizontal = DriftNoise(1e-5, 2e-6, 1e-7), 5e-5
    result = SimpleNamespace(
        posterior=SimpleNamespace(drift=drift), horizontal_rate=horizontal, elapsed=600.0
    )
    bound = advice.programme_json(result)["one_minute_white_noise_bound_deg"]
    assert bound == pytest.approx(np.degrees(np.sqrt(2.0 / 60.0) * 1e-5 / horizontal))


@pytest.mark.parametrize("sigma", [1e-2, 1e-4, 1e-7])
def test_a_peak_narrower_than_the_grid_is_refined(sigma):
    """The grid starts with steps of a quarter of a degree; mean and spread are those of a Gaussian."""

    def log_density(azimuth):
        return -0.5 * ((azimuth[None] - 0.7) / sigma) ** 2

    coarse = np.radians(np.arange(-180, 180, 0.25))
    table = log_density(coarse)
    azimuth, density = _refine_grid(log_density, coarse, np.exp(table - table.max()).sum(axis=0))
    mean = np.average(azimuth, weights=density)
    assert mean == pytest.approx(0.7, abs=0.01 * sigma)
    assert np.sqrt(np.average((azimuth - mean) ** 2, weights=density)) == pytest.approx(sigma, rel=0.01)


def test_advice_keeps_to_the_bound_and_prefers_short_stops_for_more_drift():
    horizontal = 5e-5
    quiet, drifting = DriftNoise(1e-5, 1e-9, 1e-9), DriftNoise(1e-5, 2e-5, 2e-6)
    assert programme_sigma(quiet, 34, 40, 0.0, horizontal) == pytest.approx(
        white_noise_azimuth_bound(quiet.n, 34 * 40, horizontal), rel=0.04
    )
    slow, fast = (find_best_programme(d, 1800, 2.0, horizontal) for d in (quiet, drifting))
    assert fast.stop < slow.stop and fast.sigma > slow.sigma
    enough = find_shortest_programme(quiet, np.radians(1), 2.0, horizontal)
    assert enough.sigma <= np.radians(1)
    assert find_best_programme(quiet, 5.0, 2.0, horizontal) is None
    assert find_shortest_programme(drifting, np.radians(1e-4), 2.0, horizontal) is None
