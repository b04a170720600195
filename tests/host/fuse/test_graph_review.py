"""What is said of a solved graph: how far its fixes may be trusted, and what a user should know."""

from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import find_runs
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.review import estimate_sigma_growth, review_solution


def graph_of(off, sigma=1.0):
    """(graph, solution) of fixes that are off by so many m east and north, (n, 2)."""
    count = len(off)
    fixes = PositionFactors(np.arange(count), -np.asarray(off), np.full(count, sigma), np.zeros((count, 2)))
    solution = SimpleNamespace(
        poses=np.zeros((count, 3)),
        constants=np.zeros(N_CONSTANTS),
        covariance=np.zeros((count, 3, 3)),
        converged=True,
        iterations=7,
    )
    return FactorGraph((fixes,)), solution


def alternating(count, size):
    """Errors of one size, each unlike the one before."""
    return size * np.column_stack([(-1.0) ** np.arange(count), (-1.0) ** (np.arange(count) // 2)])


@pytest.mark.parametrize("grown", [1.0, 1.5])
@pytest.mark.parametrize(
    ("count", "size", "growth"),
    # A tenth more shows in no track; and of 50 fixes four sigma of chance are 1.25.
    [
        (2000, 1.09, 1.0),
        (2000, 1.11, 1.11),
        (50, 1.24, 1.0),
        (50, 1.26, 1.26),
        (30, 2.0, 2.0),
        (29, 2.0, 1.0),
    ],
)
def test_sigmas_grow_where_fixes_scatter_more_than_they_say_and_than_chance(count, size, growth, grown):
    graph, solution = graph_of(alternating(count, size), grown)
    found, why = estimate_sigma_growth(graph, solution, grown)
    if count < 30:
        assert (found, why) == (grown, [])
        return
    assert found == pytest.approx(growth)
    assert len(why) == (growth > 1.0)
    assert all(f"{growth:.1f} times" in line for line in why)


def test_without_fixes_sigmas_stay_as_they_are():
    _, solution = graph_of(alternating(40, 2.0))
    assert estimate_sigma_growth(FactorGraph(()), solution, 1.3) == (1.3, [])


@pytest.mark.parametrize("alike", [2, 5, 10])
def test_fixes_that_are_alike_count_as_one(alike):
    """The autocorrelation of errors that stay for k fixes is a triangle: 1 + 2 sum is k."""
    rng = np.random.default_rng(6)
    off = np.repeat(rng.standard_normal((20_000 // alike, 2)), alike, axis=0)
    found, why = estimate_sigma_growth(*graph_of(0.9 * off), 1.0)
    # What is below four sigma of chance is not summed up.
    assert found == pytest.approx(np.sqrt(alike), rel=0.05)
    assert f"{alike} count as one" in why[0]


def test_a_mean_that_all_fixes_share_is_no_likeness():
    rng = np.random.default_rng(7)
    off = 0.7 * rng.standard_normal((2000, 2)) + [0.6, -0.4]
    assert estimate_sigma_growth(*graph_of(off), 1.0) == (1.0, [])


def test_a_fix_that_hardly_counts_has_no_say():
    """Of five sigma and more."""
    off = alternating(400, 1.0)
    off[::10] *= 8.0
    assert estimate_sigma_growth(*graph_of(off), 1.0)[0] == pytest.approx(1.0)


def said(off, sigma=1.0, **changes):
    graph, solution = graph_of(off, sigma)
    known = changes.pop("known", True)
    vars(solution).update(changes)
    return review_solution(graph, solution, np.arange(len(off)) * 2.0, known)


def test_fixes_that_jumped_are_told_by_their_stretch():
    assert said(alternating(20, 1.0)) == []
    for sigmas, words in ((4.8, 0), (5.2, 1)):
        off = np.zeros((20, 2))
        off[5:9, 0], off[7, 0] = 3.0 * sigmas, 3.0 * (sigmas + 1.0 * words)
        lines = said(off, 3.0)
        assert len(lines) == words
        expected = f"4 fixes from t = 10.0 to 16.0 s are off by up to {3.0 * (sigmas + 1.0):.1f} m"
        assert all(expected in line for line in lines)
    assert any("one fix only" in line for line in said(np.zeros((1, 2))))


@pytest.mark.parametrize(("known", "words"), [(True, "too few or too close"), (False, "nothing measures it")])
def test_a_heading_that_is_known_to_seventeen_degrees_only_is_told(known, words):
    for sigma, lines in ((0.29, 0), (0.31, 1), (9.0, 1)):
        found = said(np.zeros((20, 2)), covariance=np.full((20, 3, 3), sigma**2), known=known)
        assert len(found) == lines
        degrees = min(np.degrees(sigma), 180.0)
        assert all(words in line and f"{degrees:.0f} degrees" in line for line in found)


def test_a_graph_that_has_not_settled_says_so():
    assert any(
        "not converged after 7 iterations" in line for line in said(np.zeros((20, 2)), converged=False)
    )


def test_a_stretch_bridges_two_sound_ones():
    def of(*flags):
        return find_runs(np.array(flags, bool))

    assert of(0, 0, 0) == []
    assert of(0, 1, 0, 0, 1, 1, 0) == [(1, 5)]
    assert of(1, 0, 0, 0, 1, 0, 0, 1) == [(0, 0), (4, 7)]
