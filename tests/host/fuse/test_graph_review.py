"""Review of a solved graph: inflation of the fixes' sigmas, and warnings."""

from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import find_bridged_runs
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.review import estimate_sigma_growth, review_solution


def graph_with_errors(errors, sigma=1.0):
    """Return (graph, solution) whose fixes have these errors, (n, 2), m east and north."""
    count = len(errors)
    fixes = PositionFactors(
        np.arange(count), -np.asarray(errors), np.full(count, sigma), np.zeros((count, 2))
    )
    solution = SimpleNamespace(
        poses=np.zeros((count, 3)),
        constants=np.zeros(N_CONSTANTS),
        covariance=np.zeros((count, 3, 3)),
        converged=True,
        iterations=7,
    )
    return FactorGraph((fixes,)), solution


def alternating(count, size):
    """Return errors of equal size with alternating signs."""
    return size * np.column_stack([(-1.0) ** np.arange(count), (-1.0) ** (np.arange(count) // 2)])


@pytest.mark.parametrize("previous_growth", [1.0, 1.5])
@pytest.mark.parametrize(
    ("count", "size", "growth"),
    # An excess below 10 % has no effect; with 50 fixes the four-sigma limit of chance is 1.25.
    [
        (2000, 1.09, 1.0),
        (2000, 1.11, 1.11),
        (50, 1.24, 1.0),
        (50, 1.26, 1.26),
        (30, 2.0, 2.0),
        (29, 2.0, 1.0),
    ],
)
def test_sigmas_grow_where_fixes_scatter_significantly_more_than_declared(
    count, size, growth, previous_growth
):
    graph, solution = graph_with_errors(alternating(count, size), previous_growth)
    result, reasons = estimate_sigma_growth(graph, solution, previous_growth)
    if count < 30:
        assert (result, reasons) == (previous_growth, [])
        return
    assert result == pytest.approx(growth)
    assert len(reasons) == (growth > 1.0)
    assert all(f"{growth:.1f} times" in line for line in reasons)


def test_without_fixes_sigmas_are_unchanged():
    _, solution = graph_with_errors(alternating(40, 2.0))
    assert estimate_sigma_growth(FactorGraph(()), solution, 1.3) == (1.3, [])


@pytest.mark.parametrize("repeats", [2, 5, 10])
def test_repeated_fixes_count_as_one(repeats):
    """The sum 1 + 2 Σ of the autocorrelation of errors repeated k times is k."""
    rng = np.random.default_rng(6)
    error = np.repeat(rng.standard_normal((20_000 // repeats, 2)), repeats, axis=0)
    result, reasons = estimate_sigma_growth(*graph_with_errors(0.9 * error), 1.0)
    # Autocorrelations below four sigma of chance are left out of the sum.
    assert result == pytest.approx(np.sqrt(repeats), rel=0.05)
    assert f"{repeats} count as one" in reasons[0]


def test_a_common_offset_of_all_fixes_is_not_a_correlation():
    rng = np.random.default_rng(7)
    error = 0.7 * rng.standard_normal((2000, 2)) + [0.6, -0.4]
    assert estimate_sigma_growth(*graph_with_errors(error), 1.0) == (1.0, [])


def test_outlier_fixes_do_not_affect_the_growth():
    """Fixes with errors of five sigma and more have a low weight."""
    error = alternating(400, 1.0)
    error[::10] *= 8.0
    assert estimate_sigma_growth(*graph_with_errors(error), 1.0)[0] == pytest.approx(1.0)


def review_warnings(errors, sigma=1.0, **changes):
    """Return the warnings about such fixes; changes: values of the solution."""
    graph, solution = graph_with_errors(errors, sigma)
    heading_known = changes.pop("heading_known", True)
    vars(solution).update(changes)
    return review_solution(graph, solution, np.arange(len(errors)) * 2.0, heading_known)


def test_fixes_that_jumped_are_reported_run_by_run():
    assert review_warnings(alternating(20, 1.0)) == []
    for sigmas, n_lines in ((4.8, 0), (5.2, 1)):
        error = np.zeros((20, 2))
        error[5:9, 0], error[7, 0] = 3.0 * sigmas, 3.0 * (sigmas + 1.0 * n_lines)
        lines = review_warnings(error, 3.0)
        assert len(lines) == n_lines
        expected = f"4 fixes from t = 10.0 to 16.0 s are off by up to {3.0 * (sigmas + 1.0):.1f} m"
        assert all(expected in line for line in lines)
    assert any("one fix only" in line for line in review_warnings(np.zeros((1, 2))))


@pytest.mark.parametrize(
    ("heading_known", "text"), [(True, "too few or too close"), (False, "nothing measures it")]
)
def test_a_heading_sigma_above_seventeen_degrees_is_reported(heading_known, text):
    for sigma, n_lines in ((0.29, 0), (0.31, 1), (9.0, 1)):
        result = review_warnings(
            np.zeros((20, 2)), covariance=np.full((20, 3, 3), sigma**2), heading_known=heading_known
        )
        assert len(result) == n_lines
        degrees = min(np.degrees(sigma), 180.0)
        assert all(text in line and f"{degrees:.0f} degrees" in line for line in result)


def test_a_graph_that_has_not_converged_is_reported():
    assert any(
        "not converged after 7 iterations" in line
        for line in review_warnings(np.zeros((20, 2)), converged=False)
    )


def test_a_run_of_outliers_bridges_two_inliers():
    def runs_of(*flags):
        return find_bridged_runs(np.array(flags, bool))

    assert runs_of(0, 0, 0) == []
    assert runs_of(0, 1, 0, 0, 1, 1, 0) == [(1, 5)]
    assert runs_of(1, 0, 0, 0, 1, 0, 0, 1) == [(0, 0), (4, 7)]
