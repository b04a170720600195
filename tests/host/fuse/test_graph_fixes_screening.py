"""Screening of fixes by the distance rolled: consistent runs and scatter."""

from itertools import combinations, pairwise

import numpy as np
import pytest

from hubodo.fuse.graph.fixes import estimate_scatter, find_consistent_fixes


def reachable(position, distance, sigma, a, b):
    """Return True if fix b is within 105 % of the distance rolled and six sigma of fix a."""
    return abs(position[b] - position[a]) <= 1.05 * (distance[b] - distance[a]) + 6.0 * np.hypot(
        sigma[a], sigma[b]
    )


def count_largest_set(position, distance, sigma):
    """Return the number of fixes in the longest sequence of runs, and the number of runs."""
    cuts = [k for k in range(1, len(position)) if not reachable(position, distance, sigma, k - 1, k)]
    edges = [0, *cuts, len(position)]
    runs = list(pairwise(edges))
    largest = 0
    for count in range(1, len(runs) + 1):
        for chosen in combinations(runs, count):
            if all(reachable(position, distance, sigma, a[1] - 1, b[0]) for a, b in pairwise(chosen)):
                largest = max(largest, sum(end - start for start, end in chosen))
    return largest, len(runs)


@pytest.mark.parametrize("seed", range(12))
def test_the_selected_runs_are_the_largest_mutually_reachable_set(seed):
    rng = np.random.default_rng(seed)
    distance = np.cumsum(rng.uniform(0.0, 4.0, 40))
    sigma = rng.uniform(0.2, 2.0, 40)
    jumps = np.where(rng.random(40) < 0.2, rng.normal(0.0, 30.0, 40), 0.0)
    position = distance + 1j * np.cumsum(jumps)
    largest, runs = count_largest_set(position, distance, sigma)
    assert 3 <= runs <= 15, f"seed {seed}"
    retained = find_consistent_fixes(position, distance, sigma)
    assert retained.sum() == largest
    chosen = np.flatnonzero(retained)
    assert all(reachable(position, distance, sigma, a, b) for a, b in pairwise(chosen))


@pytest.mark.parametrize(("factor", "n_retained"), [(0.99, 5), (1.01, 3)])
def test_fixes_are_separated_by_a_change_beyond_distance_and_six_sigma(factor, n_retained):
    distance, sigma = np.array([0.0, 1.0, 2.0, 6.0, 7.0]), np.array([1.0, 1.0, 3.0, 4.0, 1.0])
    jump = factor * (1.05 * 4.0 + 6.0 * 5.0)
    position = np.array([0.0, 1.0, 2.0, 2.0 + jump, 2.0 + jump + 1.0]) * np.exp(0.3j)
    assert find_consistent_fixes(position, distance, sigma).tolist() == [True] * 3 + [n_retained == 5] * 2


def test_beyond_four_hundred_jumps_no_fix_is_dropped():
    for jumps, n_retained in ((400, 201), (401, 402)):
        position = 100.0 * (np.arange(jumps + 1) % 2) + 0j
        assert find_consistent_fixes(position, np.zeros(jumps + 1), np.ones(jumps + 1)).sum() == n_retained


def test_scatter_is_the_median_change_beyond_the_distance_rolled():
    """The median norm of the change of two white errors is sqrt(2 ln 2) times sqrt(2) sigma."""
    sigma = np.where(np.arange(30) % 2, 3.0, 4.0)
    for factor, expected in ((1.29, 1.0), (1.31, 1.31), (4.0, 4.0)):
        change = factor * np.sqrt(2.0 * np.log(2.0)) * 5.0
        distance = 2.0 * np.arange(30.0)
        position = (change + 2.0) * np.arange(30.0) * np.exp(1.1j)
        assert estimate_scatter(position, distance, sigma) == pytest.approx(expected, rel=1e-4)
        assert estimate_scatter(position[:29], distance[:29], sigma[:29]) == 1.0
    # The distance rolled is subtracted, however small the change.
    assert estimate_scatter(np.zeros(30) + 0j, 50.0 * np.arange(30.0), sigma) == 1.0
