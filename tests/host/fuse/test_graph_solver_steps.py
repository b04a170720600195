"""Steps of the solver: damping as in dense equations, increased after failures, decreased after success."""

import math

import numpy as np
import pytest

from graph_drives import small_drive_graph
from hubodo.fuse.graph import solver
from hubodo.fuse.graph.factors.constants import N_CONSTANTS, ConstantSigmas
from hubodo.fuse.graph.factors.factor import LinearisedFactors
from hubodo.fuse.graph.factors.loss import QUADRATIC
from hubodo.fuse.graph.solver import solve_graph


@pytest.fixture(scope="module")
def drive():
    return small_drive_graph(np.random.default_rng(41))


def dense_equations(linear, n):
    """Return H and gradient over all poses and then the constants, from weighted rows."""
    size = 3 * n + N_CONSTANTS
    h, gradient = np.zeros((size, size)), np.zeros(size)
    for item, loss in linear:
        weight = loss.weight(item.squared_norms)
        for k, pose in enumerate(item.pose_index):
            row = np.zeros((item.residual.shape[1], size))
            row[:, 3 * pose : 3 * pose + 3] = item.pose_jacobian[k]
            if item.next_pose_jacobian is not None:
                row[:, 3 * pose + 3 : 3 * pose + 6] = item.next_pose_jacobian[k]
            row[:, -N_CONSTANTS:] = item.constants_jacobian[k]
            h += weight[k] * row.T @ row
            gradient += weight[k] * row.T @ item.residual[k]
    return h, gradient


@pytest.mark.parametrize("damping", [0.0, 0.3, 10.0])
def test_a_damped_step_is_that_of_the_dense_equations_with_an_increased_diagonal(drive, damping):
    n = len(drive.initial_poses)
    # Constants that are fixed at zero stay there.
    constants = np.where(ConstantSigmas().to_array() > 0.0, 0.01, 0.0)
    linear = drive.graph.linearise(drive.initial_poses, constants)
    h, slope = dense_equations(linear, n)
    expected = np.linalg.solve(h + damping * np.diag(np.diag(h)), -slope)
    step, change = solver._solve_step(linear, n, damping)
    np.testing.assert_allclose(np.append(step.ravel(), change), expected, rtol=1e-5, atol=1e-7)


def test_covariances_are_blocks_of_the_dense_inverse(drive):
    result = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS), "all")
    h, _ = dense_equations(drive.graph.linearise(result.poses, result.constants), len(drive.initial_poses))
    inverse = np.linalg.inv(h)
    for k in (0, 1, len(drive.initial_poses) - 1):
        selected = slice(3 * k, 3 * k + 3)
        np.testing.assert_allclose(result.covariance[k], inverse[selected, selected], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(result.start_covariance[k], inverse[selected, :3], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(
        result.constants_covariance, inverse[-N_CONSTANTS:, -N_CONSTANTS:], rtol=1e-4, atol=1e-12
    )
    subset = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS), "constants")
    np.testing.assert_allclose(subset.constants_covariance, result.constants_covariance, rtol=1e-6)
    assert len(subset.covariance) == len(subset.start_covariance) == 0
    none = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    assert len(none.covariance) == len(none.constants_covariance) == 0


class OneResidualGraph:
    """A graph of one pose whose x has one residual; all other residuals are zero."""

    def __init__(self, residual, slope, other_residual=0.0):
        self.residual, self.slope, self.other_residual = residual, slope, other_residual
        self.evaluated = []

    def linearise(self, poses, constants):
        x = float(poses[0, 0])
        self.evaluated.append(x)
        rows = 3 + N_CONSTANTS
        residual, by_state, by_constants = np.zeros((1, rows + 1)), np.zeros((1, rows + 1, 3)), None
        by_constants = np.zeros((1, rows + 1, N_CONSTANTS))
        residual[0, 0], by_state[0, 0, 0] = self.residual(x), self.slope(x)
        by_state[0, 1, 1] = by_state[0, 2, 2] = 1.0
        residual[0, 1:3] = poses[0, 1:]
        by_constants[0, 3:rows] = np.eye(N_CONSTANTS)
        residual[0, 3:rows], residual[0, rows] = constants, self.other_residual
        return [(LinearisedFactors(np.zeros(1, np.intp), residual, by_state, None, by_constants), QUADRATIC)]

    def solve_from(self, x):
        return solve_graph(self, np.array([[x, 0.0, 0.0]]), np.zeros(N_CONSTANTS))


def test_damping_grows_tenfold_after_a_failed_step_and_shrinks_tenfold_after_a_good_one():
    """Newton's method for the zero of the arc tangent diverges from 3; with damping it converges."""
    graph = OneResidualGraph(math.atan, lambda x: 1.0 / (1.0 + x * x))
    result = graph.solve_from(3.0)
    assert result.converged and abs(result.poses[0, 0]) < 1e-4
    assert result.iterations == len(graph.evaluated) - 1
    x, damping_factors = 3.0, []
    for candidate in graph.evaluated[1:]:
        damping_factors.append(-math.atan(x) * (1.0 + x * x) / (candidate - x) - 1.0)
        x = candidate if abs(candidate) < abs(x) else x
    expected = [0.0, *(10.0**k for k in range(-4, 2)), 1.0, 0.1, 1e-2, 1e-3, 1e-4]
    assert len(damping_factors) >= 10
    assert damping_factors[:10] == pytest.approx(expected[:10], rel=1e-3)


def test_the_solver_stays_where_no_step_descends():
    """Every other point costs four times as much, so the damping grows from 1e-4 to 1e10 times the
    diagonal.
    """
    graph = OneResidualGraph(lambda x: 1e8 if x == 1e8 else 2e8, lambda x: 1.0)
    result = graph.solve_from(1e8)
    assert result.poses[0, 0] == 1e8 and result.converged
    assert result.iterations == 16
    assert 1e8 / (1e8 - graph.evaluated[-1]) == pytest.approx(1e10, rel=1e-4)
    # A step below a tenth of a millimetre counts as none.
    assert OneResidualGraph(lambda x: x, lambda x: -1.0).solve_from(9e-5).iterations == 1
    assert OneResidualGraph(lambda x: x, lambda x: -1.0).solve_from(1.1e-4).iterations > 1


def test_an_undamped_step_with_negligible_gain_has_converged():
    """The limit of the gain is 1e-7 of (cost + 1), however long the step."""
    for gain, iterations in ((0.9e-7, 1), (1.1e-7, 2)):
        cost = 50.0
        slope = math.sqrt(2.0 * gain * (1.0 + cost)) / 5.0
        graph = OneResidualGraph(lambda x, s=slope: s * x, lambda x, s=slope: s, other_residual=10.0)
        assert graph.solve_from(5.0).iterations == iterations
    assert OneResidualGraph(lambda x: x, lambda x: 1.0).solve_from(5.0).iterations == 2
