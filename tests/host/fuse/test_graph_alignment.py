"""Alignment of odometry with fixes: rotation and shift as by least squares, with outliers."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from hubodo.fuse.graph import alignment
from hubodo.fuse.graph.alignment import align_odometry


def places(rng, n, step=1.0):
    """Return a winding path, complex, m."""
    return np.cumsum(step * np.exp(1j * np.cumsum(0.2 * rng.standard_normal(n))))


def white(rng, n):
    return rng.standard_normal(n) + 1j * rng.standard_normal(n)


@pytest.mark.parametrize("turn", [0.4, -2.5])
def test_with_few_fixes_rotation_and_shift_are_those_of_weighted_least_squares(turn):
    rng = np.random.default_rng(21)
    odometry, sigma = places(rng, 12), rng.uniform(1.0, 4.0, 12)
    fixes = np.exp(1j * turn) * odometry + (30.0 - 20.0j) + 0.5 * sigma * white(rng, 12)

    def off(v):
        misfit = (np.exp(1j * v[0]) * odometry + v[1] + 1j * v[2] - fixes) / sigma
        return np.concatenate([misfit.real, misfit.imag])

    best = least_squares(off, [turn, 30.0, -20.0], xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    alignment_result = align_odometry(odometry, fixes, sigma)
    assert alignment_result.turn_observable
    assert alignment_result.turn == pytest.approx(np.full(12, best[0]), abs=1e-6)
    assert alignment_result.position == pytest.approx(
        np.exp(1j * best[0]) * odometry + best[1] + 1j * best[2], abs=1e-5
    )


def test_a_heading_that_drifts_by_turns_is_followed_section_by_section():
    rng = np.random.default_rng(22)
    n = 800
    odometry, drift = places(rng, n), 0.3 + 4.0 * np.pi * np.arange(n) / n
    # The heading error bends the path as well.
    fixes = np.cumsum(np.diff(odometry, prepend=0.0) * np.exp(1j * drift)) + 0.3 * white(rng, n)
    alignment_result = align_odometry(odometry, fixes, np.full(n, 0.3))
    inner = slice(20, -20)
    assert np.abs(alignment_result.turn - drift)[inner].max() < 0.2
    assert np.abs(alignment_result.position - fixes).max() < 2.0


@pytest.mark.parametrize("seed", range(4))
def test_four_outliers_in_ten_fixes_change_nothing(seed):
    rng = np.random.default_rng(seed)
    n = 150
    odometry, sigma = places(rng, n), np.full(n, 2.0)
    fixes = np.exp(0.7j) * odometry - 5.0 + 1.0 * white(rng, n)
    false = rng.random(n) < 0.4
    fixes = fixes + np.where(false, 60.0 * np.exp(2j * np.pi * rng.random(n)), 0.0)
    alignment_result = align_odometry(odometry, fixes, sigma)
    assert np.abs(alignment_result.turn - 0.7).max() < 0.15
    assert np.abs(alignment_result.position - np.exp(0.7j) * odometry + 5.0).max() < 2.5


@pytest.mark.parametrize(("share", "result"), [(0.98, False), (1.02, True)])
def test_the_rotation_is_observable_where_lever_arms_exceed_sigmas(share, result):
    """The limit for two fixes at a and -a with sigma s is 2 a² / s² = 1."""
    a = 2.0 * np.sqrt(0.5 * share)
    odometry, fixes = np.array([a, -a]) + 3.0j, np.array([a, -a]) * 1j + 7.0
    alignment_result = align_odometry(odometry, fixes, np.full(2, 2.0))
    assert alignment_result.turn_observable == result
    assert alignment_result.turn == pytest.approx(np.full(2, 0.5 * np.pi if result else 0.0))
    expected = fixes if result else np.array([a, -a]) + 7.0
    assert alignment_result.position == pytest.approx(expected)


def test_the_position_of_a_stationary_vehicle_is_the_median_of_the_fixes():
    rng = np.random.default_rng(24)
    fixes = 50.0 + 20.0j + white(rng, 21)
    fixes[0] = 1e5
    alignment_result = align_odometry(np.full(21, 3.0 + 4.0j), fixes, np.ones(21))
    assert not alignment_result.turn_observable and not alignment_result.turn.any()
    assert alignment_result.position == pytest.approx(
        np.full(21, np.median(fixes.real) + 1j * np.median(fixes.imag))
    )


@pytest.mark.parametrize("start", [0, 7])
def test_a_section_ends_where_the_rotation_is_known_to_a_tenth_of_a_radian(start):
    """The variance for m fixes at distance d on a line, sigma s, is s² / (d² m (m² - 1) / 12)."""
    sigma = np.full(60, 3.0)
    for count in (8, 12, 18, 27):
        edge = 3.0 * np.sqrt(100.0 / (count * (count**2 - 1) / 12.0))
        ends = [
            alignment._find_section_end(share * edge * np.arange(60.0) + 0j, sigma, start) - start
            for share in (1.01, 0.99)
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
    """An error in one of 31 fixes shifts their mean by a 31st of it while it is an inlier."""
    odometry = 4.0 * np.arange(31.0) + 0j
    for error, inside in ((4.55, True), (4.75, False), (-4.55, True), (-4.75, False)):
        fixes = odometry + np.where(np.arange(31) == 15, 1j * 2.0 * error, 0.0)
        agrees = alignment._find_inliers(odometry, fixes, np.full(31, 2.0))
        assert agrees.tolist() == [k != 15 or inside for k in range(31)]
    # An outlier at either end would rotate the path.
    for place in (0, 30):
        fixes = odometry + np.where(np.arange(31) == place, 40.0j, 0.0)
        agrees = alignment._find_inliers(odometry, fixes, np.full(31, 2.0))
        assert agrees.tolist() == [k != place for k in range(31)]
