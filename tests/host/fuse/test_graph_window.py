"""Marginalisation in a window, compared with the full graph and with GTSAM's marginals."""

import numpy as np
import pytest

from graph_drives import numeric, small_drive
from gtsam_oracle import covariances_of_gtsam, solve_with_gtsam
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.loss import QUADRATIC
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.factors.prior import ConstantsPriorFactors, MarginalPriorFactors, PosePriorFactors
from hubodo.fuse.graph.solver import solve_graph
from hubodo.fuse.graph.window import PoseWindow, marginalise_first_poses


def weighted_dense(graph, poses, constants):
    """Return the information of poses and constants by numerical differentiation."""
    n = len(poses)

    def residuals(z):
        linear = graph.linearise(z[: 3 * n].reshape(n, 3), z[3 * n :])
        rows = [np.sqrt(w)[:, None] * item.residual for (item, _), w in zip(linear, weights, strict=True)]
        return np.concatenate([row.ravel() for row in rows])

    weights = [loss.weight(item.squared_norms) for item, loss in graph.linearise(poses, constants)]
    j = numeric(residuals, np.append(poses.ravel(), constants))
    return j.T @ j


@pytest.mark.parametrize("count", [1, 2, 17])
def test_marginalising_poses_gives_the_marginal_of_the_full_graph(count):
    """At the linearisation point, the covariance of the remaining poses is the block of the dense inverse.

    The weights of robust losses are as they are.
    """
    drive = small_drive(np.random.default_rng(31), 12)
    rng = np.random.default_rng(32)
    poses, constants = (
        drive.initial_poses + rng.normal(0, 0.05, drive.initial_poses.shape),
        rng.normal(0, 1e-3, N_CONSTANTS),
    )
    small = marginalise_first_poses(drive.graph, poses, constants, count)
    full = np.linalg.inv(weighted_dense(drive.graph, poses, constants))
    left = np.linalg.inv(weighted_dense(small, poses[count:], constants))
    scale = np.sqrt(np.diag(left))
    assert np.max(np.abs(left - full[3 * count :, 3 * count :]) / np.outer(scale, scale)) < 1e-4


def test_the_remaining_graph_has_the_optimum_of_the_full_graph():
    drive = small_drive(np.random.default_rng(33))
    full = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS), "all")
    small = marginalise_first_poses(drive.graph, full.poses, full.constants, 20)
    kinds = {type(factor) for factor in small.factors}
    assert MarginalPriorFactors in kinds
    assert not kinds & {PosePriorFactors, ConstantsPriorFactors}
    shaken = full.poses[20:] + np.random.default_rng(34).normal(0, 0.02, full.poses[20:].shape)
    repeated = solve_graph(small, shaken, np.zeros(N_CONSTANTS), "all")
    assert np.max(np.abs(repeated.poses - full.poses[20:])) < 1e-4
    assert np.max(np.abs(repeated.constants - full.constants)) < 1e-6
    assert np.allclose(repeated.covariance, full.covariance[20:], rtol=1e-3, atol=1e-9)
    assert np.allclose(repeated.constants_covariance, full.constants_covariance, rtol=1e-3, atol=1e-12)


def test_a_fix_forgotten_as_refused_stays_refused():
    drive = small_drive(np.random.default_rng(35), 40)
    positions = drive.graph.find_group(PositionFactors)
    place = positions.position.copy()
    place[2] += 40.0
    shifted = type(positions)(
        positions.pose_index,
        place,
        positions.sigma,
        positions.velocity,
        positions.antenna,
        loss=positions.loss,
    )
    remaining = tuple(factor for factor in drive.graph.factors if factor is not positions)
    lost = shifted.select_poses(0, int(shifted.pose_index[2])).append(
        shifted.select_poses(int(shifted.pose_index[2]) + 1, len(drive.initial_poses)),
        int(shifted.pose_index[2]) + 1,
    )
    full = solve_graph(FactorGraph((shifted, *remaining)), drive.initial_poses, np.zeros(N_CONSTANTS))
    with_it = marginalise_first_poses(FactorGraph((shifted, *remaining)), full.poses, full.constants, 20)
    without = marginalise_first_poses(FactorGraph((lost, *remaining)), full.poses, full.constants, 20)
    first, second = (solve_graph(graph, full.poses[20:], full.constants) for graph in (with_it, without))
    assert np.allclose(first.poses, second.poses, atol=1e-6)


def test_gtsam_has_the_same_optimum_and_marginals_of_a_marginalised_graph():
    drive = small_drive(np.random.default_rng(36), 30)
    graph = drive.graph.with_losses(lambda factor: QUADRATIC)
    full = solve_graph(graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    small = marginalise_first_poses(graph, full.poses, full.constants, 15)
    ours = solve_graph(small, full.poses[15:], full.constants, "all")
    poses, constants, cost = solve_with_gtsam(small, full.poses[15:] + 0.01, np.zeros(N_CONSTANTS))
    assert cost == pytest.approx(ours.cost, rel=1e-6)
    assert np.max(np.abs(poses - ours.poses)) < 1e-4
    assert np.max(np.abs(constants - ours.constants)) < 1e-5
    # GTSAM's marginals of the full graph.
    blocks, of_constants = covariances_of_gtsam(graph, full.poses, full.constants)
    assert np.allclose(ours.covariance, blocks[15:], rtol=1e-3, atol=1e-9)
    assert np.allclose(ours.constants_covariance, of_constants, rtol=1e-3, atol=1e-12)


def test_a_window_keeps_at_least_two_poses():
    drive = small_drive(np.random.default_rng(37), 12)
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
    short = window.without_poses_before(1e9)
    assert short.pose_t.tolist() == drive.odometry.pose_t[-2:].tolist()
    repeated = short.with_solution()
    assert np.allclose(repeated.poses, result.poses[-2:], atol=1e-4)
    assert np.allclose(repeated.covariance, result.covariance[-1], rtol=1e-3, atol=1e-9)
