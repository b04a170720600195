"""Marginalisation of poses in a window, against the full graph and the marginals of GTSAM."""

import numpy as np
import pytest

from graph_drives import central_differences, small_drive_graph
from gtsam_oracle import covariances_of_gtsam, solve_with_gtsam
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.loss import QUADRATIC
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.factors.prior import ConstantsPriorFactors, MarginalPriorFactors, PosePriorFactors
from hubodo.fuse.graph.solver import solve_graph
from hubodo.fuse.graph.window import PoseWindow, marginalise_first_poses


def dense_information(graph, poses, constants):
    """Return the information matrix of poses and constants by numerical differentiation."""
    n = len(poses)

    def residuals(z):
        linear = graph.linearise(z[: 3 * n].reshape(n, 3), z[3 * n :])
        rows = [np.sqrt(w)[:, None] * item.residual for (item, _), w in zip(linear, weights, strict=True)]
        return np.concatenate([row.ravel() for row in rows])

    weights = [loss.weight(item.squared_norms) for item, loss in graph.linearise(poses, constants)]
    j = central_differences(residuals, np.append(poses.ravel(), constants))
    return j.T @ j


@pytest.mark.parametrize("count", [1, 2, 17])
def test_marginalising_poses_gives_the_marginal_of_the_full_graph(count):
    """The covariance of the remaining poses equals the block of the dense inverse.

    Both are linearised at the same point with the same weights of the robust losses.
    """
    drive = small_drive_graph(np.random.default_rng(31), 12)
    rng = np.random.default_rng(32)
    poses, constants = (
        drive.initial_poses + rng.normal(0, 0.05, drive.initial_poses.shape),
        rng.normal(0, 1e-3, N_CONSTANTS),
    )
    marginalised = marginalise_first_poses(drive.graph, poses, constants, count)
    full = np.linalg.inv(dense_information(drive.graph, poses, constants))
    remaining = np.linalg.inv(dense_information(marginalised, poses[count:], constants))
    scale = np.sqrt(np.diag(remaining))
    assert np.max(np.abs(remaining - full[3 * count :, 3 * count :]) / np.outer(scale, scale)) < 1e-4


def test_the_remaining_graph_has_the_optimum_of_the_full_graph():
    drive = small_drive_graph(np.random.default_rng(33))
    full = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS), "all")
    marginalised = marginalise_first_poses(drive.graph, full.poses, full.constants, 20)
    kinds = {type(factor) for factor in marginalised.factors}
    assert MarginalPriorFactors in kinds
    assert not kinds & {PosePriorFactors, ConstantsPriorFactors}
    perturbed = full.poses[20:] + np.random.default_rng(34).normal(0, 0.02, full.poses[20:].shape)
    solved_again = solve_graph(marginalised, perturbed, np.zeros(N_CONSTANTS), "all")
    assert np.max(np.abs(solved_again.poses - full.poses[20:])) < 1e-4
    assert np.max(np.abs(solved_again.constants - full.constants)) < 1e-6
    assert np.allclose(solved_again.covariance, full.covariance[20:], rtol=1e-3, atol=1e-9)
    assert np.allclose(solved_again.constants_covariance, full.constants_covariance, rtol=1e-3, atol=1e-12)


def test_a_fix_rejected_when_marginalised_stays_rejected():
    drive = small_drive_graph(np.random.default_rng(35), 40)
    positions = drive.graph.find_group(PositionFactors)
    position = positions.position.copy()
    position[2] += 40.0
    shifted = type(positions)(
        positions.pose_index,
        position,
        positions.sigma,
        positions.velocity,
        positions.antenna,
        loss=positions.loss,
    )
    other_factors = tuple(factor for factor in drive.graph.factors if factor is not positions)
    without_fix = shifted.select_poses(0, int(shifted.pose_index[2])).append(
        shifted.select_poses(int(shifted.pose_index[2]) + 1, len(drive.initial_poses)),
        int(shifted.pose_index[2]) + 1,
    )
    full = solve_graph(FactorGraph((shifted, *other_factors)), drive.initial_poses, np.zeros(N_CONSTANTS))
    with_outlier = marginalise_first_poses(
        FactorGraph((shifted, *other_factors)), full.poses, full.constants, 20
    )
    without_outlier = marginalise_first_poses(
        FactorGraph((without_fix, *other_factors)), full.poses, full.constants, 20
    )
    first, second = (
        solve_graph(graph, full.poses[20:], full.constants) for graph in (with_outlier, without_outlier)
    )
    assert np.allclose(first.poses, second.poses, atol=1e-6)


def test_optimum_and_marginals_of_a_marginalised_graph_equal_those_of_gtsam():
    drive = small_drive_graph(np.random.default_rng(36), 30)
    graph = drive.graph.with_losses(lambda factor: QUADRATIC)
    full = solve_graph(graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    marginalised = marginalise_first_poses(graph, full.poses, full.constants, 15)
    ours = solve_graph(marginalised, full.poses[15:], full.constants, "all")
    poses, constants, cost = solve_with_gtsam(marginalised, full.poses[15:] + 0.01, np.zeros(N_CONSTANTS))
    assert cost == pytest.approx(ours.cost, rel=1e-6)
    assert np.max(np.abs(poses - ours.poses)) < 1e-4
    assert np.max(np.abs(constants - ours.constants)) < 1e-5
    # GTSAM's marginals of the full graph.
    blocks, constants_covariance = covariances_of_gtsam(graph, full.poses, full.constants)
    assert np.allclose(ours.covariance, blocks[15:], rtol=1e-3, atol=1e-9)
    assert np.allclose(ours.constants_covariance, constants_covariance, rtol=1e-3, atol=1e-12)


def test_a_window_keeps_at_least_two_poses():
    drive = small_drive_graph(np.random.default_rng(37), 12)
    result = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS), "all")
    window = PoseWindow(
        drive.graph,
        drive.odometry.pose_t,
        result.poses,
        result.constants,
        result.covariance[-1],
        result.constants_covariance,
    )
    assert window.without_poses_before(-1.0) is window
    shortest = window.without_poses_before(1e9)
    assert shortest.pose_t.tolist() == drive.odometry.pose_t[-2:].tolist()
    solved_again = shortest.with_solution()
    assert np.allclose(solved_again.poses, result.poses[-2:], atol=1e-4)
    assert np.allclose(solved_again.covariance, result.covariance[-1], rtol=1e-3, atol=1e-9)
