"""Alignment of odometry with fixes: rotation and translation, robust to outliers."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from hubodo.fuse.graph import alignment
from hubodo.fuse.graph.alignment import align_odometry


def winding_positions(rng, n, step=1.0):
    """Return positions along a winding path, complex, m."""
    return np.cumsum(step * np.exp(1j * np.cumsum(0.2 * rng.standard_normal(n))))


def white_noise(rng, n):
    return rng.standard_normal(n) + 1j * rng.standard_normal(n)


@pytest.mark.parametrize("turn", [0.4, -2.5])
def test_with_few_fixes_the_alignment_equals_weighted_least_squares(turn):
    rng = np.random.default_rng(21)
    odometry, sigma = winding_positions(rng, 12), rng.uniform(1.0, 4.0, 12)
    fixes = np.exp(1j * turn) * odometry + (30.0 - 20.0j) + 0.5 * sigma * white_noise(rng, 12)

    def residuals(parameters):
        difference = (
            np.exp(1j * parameters[0]) * odometry + parameters[1] + 1j * parameters[2] - fixes
        ) / sigma
        return np.concatenate([difference.real, difference.imag])

    best = least_squares(residuals, [turn, 30.0, -20.0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    alignment_result = align_odometry(odometry, fixes, sigma)
    assert alignment_result.turn_observable
    assert alignment_result.turn == pytest.approx(np.full(12, best[0]), abs=1e-6)
    assert alignment_result.position == pytest.approx(
        np.exp(1j * best[0]) * odometry + best[1] + 1j * best[2], abs=1e-5
    )


def test_a_drift_of_the_heading_by_full_turns_is_followed_section_by_section():
    rng = np.random.default_rng(22)
    n = 800
    odometry, drift = winding_positions(rng, n), 0.3 + 4.0 * np.pi * np.arange(n) / n
    # The heading error bends the path as well.
    fixes = np.cumsum(np.diff(odometry, prepend=0.0) * np.exp(1j * drift)) + 0.3 * white_noise(rng, n)
    alignment_result = align_odometry(odometry, fixes, np.full(n, 0.3))
    inner = slice(20, -20)
    assert np.abs(alignment_result.turn - drift)[inner].max() < 0.2
    assert np.abs(alignment_result.position - fixes).max() < 2.0


@pytest.mark.parametrize("seed", range(4))
def test_forty_percent_outliers_do_not_change_the_alignment(seed):
    rng = np.random.default_rng(seed)
    n = 150
    odometry, sigma = winding_positions(rng, n), np.full(n, 2.0)
    fixes = np.exp(0.7j) * odometry - 5.0 + 1.0 * white_noise(rng, n)
    is_outlier = rng.random(n) < 0.4
    fixes = fixes + np.where(is_outlier, 60.0 * np.exp(2j * np.pi * rng.random(n)), 0.0)
    alignment_result = align_odometry(odometry, fixes, sigma)
    assert np.abs(alignment_result.turn - 0.7).max() < 0.15
    assert np.abs(alignment_result.position - np.exp(0.7j) * odometry + 5.0).max() < 2.5


@pytest.mark.parametrize(("factor", "observable"), [(0.98, False), (1.02, True)])
def test_the_rotation_is_observable_if_the_extent_of_the_fixes_exceeds_their_sigma(factor, observable):
    """The limit for two fixes at a and -a with sigma s is 2 a² / s² = 1."""
    a = 2.0 * np.sqrt(0.5 * factor)
    odometry, fixes = np.array([a, -a]) + 3.0j, np.array([a, -a]) * 1j + 7.0
    alignment_result = align_odometry(odometry, fixes, np.full(2, 2.0))
    assert alignment_result.turn_observable == observable
    assert alignment_result.turn == pytest.approx(np.full(2, 0.5 * np.pi if observable else 0.0))
    expected = fixes if observable else np.array([a, -a]) + 7.0
    assert alignment_result.position == pytest.approx(expected)


def test_the_position_of_a_stationary_vehicle_is_the_median_of_the_fixes():
    rng = np.random.default_rng(24)
    fixes = 50.0 + 20.0j + white_noise(rng, 21)
    fixes[0] = 1e5
    alignment_result = align_odometry(np.full(21, 3.0 + 4.0j), fixes, np.ones(21))
    assert not alignment_result.turn_observable and not alignment_result.turn.any()
    assert alignment_result.position == pytest.approx(
        np.full(21, np.median(fixes.real) + 1j * np.median(fixes.imag))
    )


@pytest.mark.parametrize("start", [0, 7])
def test_a_section_ends_when_the_rotation_sigma_reaches_a_tenth_of_a_radian(start):
    """The variance for m fixes at distance d on a line, sigma s, is s² / (d² m (m² - 1) / 12)."""
    sigma = np.full(60, 3.0)
    for count in (8, 12, 18, 27):
        spacing = 3.0 * np.sqrt(100.0 / (count * (count**2 - 1) / 12.0))
        ends = [
            alignment._find_section_end(factor * spacing * np.arange(60.0) + 0j, sigma, start) - start
            for factor in (1.01, 0.99)
        ]
        assert ends[0] == count and ends[1] > count
    assert alignment._find_section_end(1e-3 * np.arange(60.0) + 0j, sigma, start) == 60
    assert alignment._find_section_end(10.0 * np.arange(60.0) + 0j, sigma, 55) == 60


@pytest.mark.parametrize(("n", "last"), [(24, 14), (25, 5)])
def test_a_remainder_shorter_than_half_a_section_is_merged_into_the_last_section(monkeypatch, n, last):
    """Sections have ten fixes: the last 4 of 24 are merged, the last 5 of 25 are a section."""
    inspected, find_inliers = [], alignment._find_inliers
    monkeypatch.setattr(alignment, "_find_section_end", lambda o, sigma, start: min(start + 10, len(o)))
    monkeypatch.setattr(
        alignment, "_find_inliers", lambda o, g, sigma: inspected.append(len(o)) or find_inliers(o, g, sigma)
    )
    distance = 5.0 * np.arange(n) + 0j
    assert align_odometry(distance, distance, np.ones(n)).position == pytest.approx(distance)
    assert inspected[-1] == last and sum(inspected) == n


def test_an_inlier_lies_within_four_and_a_half_sigmas():
    """The error of one of 31 fixes shifts their mean by a 31st of it while the fix is an inlier."""
    odometry = 4.0 * np.arange(31.0) + 0j
    for error, is_inlier in ((4.55, True), (4.75, False), (-4.55, True), (-4.75, False)):
        fixes = odometry + np.where(np.arange(31) == 15, 1j * 2.0 * error, 0.0)
        inliers = alignment._find_inliers(odometry, fixes, np.full(31, 2.0))
        assert inliers.tolist() == [k != 15 or is_inlier for k in range(31)]
    # An outlier at either end would rotate the path.
    for index in (0, 30):
        fixes = odometry + np.where(np.arange(31) == index, 40.0j, 0.0)
        inliers = alignment._find_inliers(odometry, fixes, np.full(31, 2.0))
        assert inliers.tolist() == [k != index for k in range(31)]
