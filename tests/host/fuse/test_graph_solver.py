"""Solver of the graph: linear algebra, and the same optimum as other solvers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from graph_drives import central_differences, small_drive_graph, wiggly_path
from gtsam_oracle import solve_with_gtsam
from hubodo.fuse.graph.build import build_graph
from hubodo.fuse.graph.chain import solve_chain
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import CONSTANT_NAMES, N_CONSTANTS, ConstantSigmas
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.factors.loss import QUADRATIC
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.factors.prior import PosePriorFactors
from hubodo.fuse.graph.solver import solve_from_poor_guess, solve_graph


def replace_factors(graph, kind, **values):
    """Return the graph with other values in the factors of one kind."""
    factors = (replace(item, **values) if isinstance(item, kind) else item for item in graph.factors)
    return FactorGraph(tuple(factors))


@settings(max_examples=40)
@given(n=st.integers(1, 40), seed=st.integers(0, 1000))
def test_the_chain_solver_equals_a_dense_inverse(n, seed):
    rng = np.random.default_rng(seed)
    full = np.zeros((3 * n, 3 * n))
    for k in range(n):
        j = rng.normal(size=(5, 6))
        size = 6 if k + 1 < n else 3
        full[3 * k : 3 * k + size, 3 * k : 3 * k + size] += (j.T @ j)[:size, :size]
    full += 0.05 * np.eye(3 * n)
    diagonal = np.array([full[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)])
    upper = np.array([full[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6] for k in range(n - 1)]).reshape(
        n - 1, 3, 3
    )
    right = rng.normal(size=(n, 3, 2))
    result = solve_chain(diagonal, upper, right, covariance=True)
    inverse = np.linalg.inv(full)
    assert np.allclose(result.x.reshape(-1, 2), inverse @ right.reshape(-1, 2), atol=1e-8)
    for k in range(n):
        assert np.allclose(result.covariance[k], inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], atol=1e-8)
        if k + 1 < n:
            assert np.allclose(
                result.next_covariance[k], inverse[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6], atol=1e-8
            )


def test_the_chain_solver_is_accurate_for_steps_of_0_1_mm_and_fixes_of_five_metres():
    """The stiffest valid case, 10,000 poses, against the closed form of a random walk observed in noise."""
    n, q, r = 10_001, 1e-8, 25.0
    diagonal, upper = np.zeros((n, 3, 3)), np.tile(-np.eye(3) / q, (n - 1, 1, 1))
    diagonal += np.eye(3) / r
    diagonal[:-1] += np.eye(3) / q
    diagonal[1:] += np.eye(3) / q
    result = solve_chain(diagonal, upper, np.zeros((n, 3, 1)), covariance=True)
    # Eigenvectors of the path graph are cosines, its eigenvalues 2 - 2 cos(pi j / n).
    j = np.arange(1, n)
    middle = (n - 1) // 2
    shape = np.sqrt(2.0 / n) * np.cos(np.pi * j * (middle + 0.5) / n)
    exact = r / n + np.sum(shape**2 / (1.0 / r + (2.0 - 2.0 * np.cos(np.pi * j / n)) / q))
    assert result.covariance[middle, 0, 0] == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("seed", [4, 5])
def test_the_optimum_and_its_covariance_equal_those_of_scipy(seed):
    constants = replace(
        ConstantSigmas(), **{name: 0.1 for name in CONSTANT_NAMES if name.startswith("compass")}
    )
    drive = small_drive_graph(
        np.random.default_rng(seed), config=GraphConfig(antenna=(0.4, -0.2), constants=constants)
    )
    graph, n = drive.graph.with_losses(lambda factor: QUADRATIC), len(drive.initial_poses)

    def residuals(z):
        poses, constants = z[: 3 * n].reshape(n, 3), z[3 * n :]
        return np.concatenate([item.residual.ravel() for item, _ in graph.linearise(poses, constants)])

    scale = np.append(np.tile([1.0, 1.0, 0.1], n), constants.to_array())
    first = np.append(drive.initial_poses.ravel(), np.zeros(N_CONSTANTS))
    theirs = least_squares(
        residuals, first, jac="2-point", x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-12, max_nfev=60
    )
    ours = solve_graph(graph, drive.initial_poses, np.zeros(N_CONSTANTS), "all")
    assert ours.converged
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-8)
    # With a numeric Jacobian scipy is off by micrometres.
    assert np.max(np.abs((np.append(ours.poses.ravel(), ours.constants) - theirs.x) / scale)) < 1e-3
    j = central_differences(residuals, np.append(ours.poses.ravel(), ours.constants))
    covariance = np.linalg.inv(j.T @ j)
    for k in (0, n // 2, n - 1):
        part = slice(3 * k, 3 * k + 3)
        assert np.allclose(ours.covariance[k], covariance[part, part], rtol=1e-4, atol=1e-10)
        assert np.allclose(ours.start_covariance[k], covariance[part, :3], rtol=1e-4, atol=1e-8)
    assert np.allclose(ours.constants_covariance, covariance[3 * n :, 3 * n :], rtol=1e-3, atol=1e-12)


def test_the_optimum_with_robust_losses_equals_that_of_gtsam():
    rng = np.random.default_rng(6)
    drive = small_drive_graph(rng, 60)
    position = drive.graph.find_group(PositionFactors).position.copy()
    position[20:24] += 30.0
    graph = replace_factors(drive.graph, PositionFactors, position=position)
    ours = solve_from_poor_guess(graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    perturbed = ours.poses + rng.normal(0, 1, ours.poses.shape) * [0.2, 0.2, 0.02]
    poses, constants, cost = solve_with_gtsam(graph, perturbed, np.zeros(N_CONSTANTS))
    assert cost == pytest.approx(ours.cost, rel=1e-8)
    assert np.max(np.abs(poses - ours.poses)) < 1e-4
    assert np.max(np.abs(constants - ours.constants)) < 1e-5


def test_rotating_all_measurements_rotates_the_solution():
    drive = small_drive_graph(np.random.default_rng(12))
    graph = drive.graph.with_losses(lambda factor: QUADRATIC)
    angle, c, s = 1.1, np.cos(1.1), np.sin(1.1)
    matrix = np.array([[c, -s], [s, c]])
    mean = graph.find_group(PosePriorFactors).mean[0]
    rotated = replace_factors(
        graph, PositionFactors, position=graph.find_group(PositionFactors).position @ matrix.T
    )
    rotated = replace_factors(
        rotated, HeadingFactors, heading=graph.find_group(HeadingFactors).heading + angle
    )
    rotated = replace_factors(
        rotated, PosePriorFactors, mean=np.append(matrix @ mean[:2], mean[2] + angle)[None]
    )
    first = solve_graph(graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    poses = np.column_stack([drive.initial_poses[:, :2] @ matrix.T, drive.initial_poses[:, 2] + angle])
    second = solve_graph(rotated, poses, np.zeros(N_CONSTANTS))
    assert np.allclose(second.poses[:, :2], first.poses[:, :2] @ matrix.T, atol=1e-5)
    assert np.allclose(second.constants, first.constants, atol=1e-7)


def test_a_graph_without_fixes_and_headings_reproduces_the_odometry():
    drive = build_graph(wiggly_path(np.random.default_rng(13)), [], GraphConfig())
    result = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    assert np.allclose(result.poses, drive.odometry.odometry_pose, atol=1e-9)
