"""Steps of the graph's solver: damped as dense equations are, more where they fail, less where not."""

import math

import numpy as np
import pytest

from graph_drives import small_drive
from hubodo.fuse.graph import solver
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import LinearisedFactors
from hubodo.fuse.graph.factors.loss import QUADRATIC
from hubodo.fuse.graph.solver import solve_graph


@pytest.fixture(scope="module")
def drive():
    return small_drive(np.random.default_rng(41))


def dense(linear, n):
    """H and gradient over all poses and then the constants, each row times the root of its weight."""
    size = 3 * n + N_CONSTANTS
    h, slope = np.zeros((size, size)), np.zeros(size)
    for item, loss in linear:
        weight = loss.weight(item.squared_norms)
        for k, state in enumerate(item.pose_index):
            row = np.zeros((item.residual.shape[1], size))
            row[:, 3 * state : 3 * state + 3] = item.pose_jacobian[k]
            if item.next_pose_jacobian is not None:
                row[:, 3 * state + 3 : 3 * state + 6] = item.next_pose_jacobian[k]
            row[:, -N_CONSTANTS:] = item.constants_jacobian[k]
            h += weight[k] * row.T @ row
            slope += weight[k] * row.T @ item.residual[k]
    return h, slope


@pytest.mark.parametrize("damping", [0.0, 0.3, 10.0])
def test_a_step_is_that_of_the_dense_equations_with_the_diagonal_grown(drive, damping):
    n = len(drive.initial_poses)
    linear = drive.graph.linearise(drive.initial_poses, np.full(N_CONSTANTS, 0.01))
    h, slope = dense(linear, n)
    expected = np.linalg.solve(h + damping * np.diag(np.diag(h)), -slope)
    step, change = solver._solve_step(linear, n, damping)
    np.testing.assert_allclose(np.append(step.ravel(), change), expected, rtol=1e-5, atol=1e-7)


def test_covariances_are_blocks_of_the_inverse_however_many_are_asked_for(drive):
    found = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS), "all")
    h, _ = dense(drive.graph.linearise(found.poses, found.constants), len(drive.initial_poses))
    inverse = np.linalg.inv(h)
    for k in (0, 1, len(drive.initial_poses) - 1):
        own = slice(3 * k, 3 * k + 3)
        np.testing.assert_allclose(found.covariance[k], inverse[own, own], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(found.start_covariance[k], inverse[own, :3], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(
        found.constants_covariance, inverse[-N_CONSTANTS:, -N_CONSTANTS:], rtol=1e-4, atol=1e-12
    )
    few = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS), "constants")
    np.testing.assert_allclose(few.constants_covariance, found.constants_covariance, rtol=1e-6)
    assert len(few.covariance) == len(few.start_covariance) == 0
    none = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    assert len(none.covariance) == len(none.constants_covariance) == 0


class OneNumber:
    """A graph of one pose whose x has one residual; beside it all else is zero, and one stays as it is."""

    def __init__(self, residual, slope, beside=0.0):
        self.residual, self.slope, self.beside = residual, slope, beside
        self.tried = []

    def linearise(self, poses, constants):
        x = float(poses[0, 0])
        self.tried.append(x)
        rows = 3 + N_CONSTANTS
        residual, by_state, by_constants = np.zeros((1, rows + 1)), np.zeros((1, rows + 1, 3)), None
        by_constants = np.zeros((1, rows + 1, N_CONSTANTS))
        residual[0, 0], by_state[0, 0, 0] = self.residual(x), self.slope(x)
        by_state[0, 1, 1] = by_state[0, 2, 2] = 1.0
        residual[0, 1:3] = poses[0, 1:]
        by_constants[0, 3:rows] = np.eye(N_CONSTANTS)
        residual[0, 3:rows], residual[0, rows] = constants, self.beside
        return [(LinearisedFactors(np.zeros(1, np.intp), residual, by_state, None, by_constants), QUADRATIC)]

    def solved(self, x):
        return solve_graph(self, np.array([[x, 0.0, 0.0]]), np.zeros(N_CONSTANTS))


def test_a_step_that_fails_is_damped_ten_times_as_much_and_one_that_does_not_a_tenth():
    """Newton's steps to the zero of the arc tangent run away from 3, and do not when they are damped."""
    graph = OneNumber(math.atan, lambda x: 1.0 / (1.0 + x * x))
    found = graph.solved(3.0)
    assert found.converged and abs(found.poses[0, 0]) < 1e-4
    assert found.iterations == len(graph.tried) - 1
    at, damped = 3.0, []
    for tried in graph.tried[1:]:
        damped.append(-math.atan(at) * (1.0 + at * at) / (tried - at) - 1.0)
        at = tried if abs(tried) < abs(at) else at
    expected = [0.0, *(10.0**k for k in range(-4, 2)), 1.0, 0.1, 1e-2, 1e-3, 1e-4]
    assert len(damped) >= 10
    assert damped[:10] == pytest.approx(expected[:10], rel=1e-3)


def test_where_no_step_is_downhill_it_stays_where_it_is():
    """Anywhere else it costs four times as much: damped from 1e-4 to 1e10 of the diagonal."""
    graph = OneNumber(lambda x: 1e8 if x == 1e8 else 2e8, lambda x: 1.0)
    found = graph.solved(1e8)
    assert found.poses[0, 0] == 1e8 and found.converged
    assert found.iterations == 16
    assert 1e8 / (1e8 - graph.tried[-1]) == pytest.approx(1e10, rel=1e-4)
    # A step of less than a tenth of a millimetre is none.
    assert OneNumber(lambda x: x, lambda x: -1.0).solved(9e-5).iterations == 1
    assert OneNumber(lambda x: x, lambda x: -1.0).solved(1.1e-4).iterations > 1


def test_an_undamped_step_that_gains_next_to_nothing_has_arrived():
    """1e-7 of the cost and one beside it, however long the step."""
    for gain, iterations in ((0.9e-7, 1), (1.1e-7, 2)):
        cost = 50.0
        slope = math.sqrt(2.0 * gain * (1.0 + cost)) / 5.0
        graph = OneNumber(lambda x, s=slope: s * x, lambda x, s=slope: s, beside=10.0)
        assert graph.solved(5.0).iterations == iterations
    assert OneNumber(lambda x: x, lambda x: 1.0).solved(5.0).iterations == 2
