"""Factors and solvers of the graph: derivatives, losses, linear algebra, and other solvers' optimum."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import least_squares

from generators import gnss_drives
from hubodo.errors import ConfigError
from hubodo.fuse.graph.chain import solve_chain
from hubodo.fuse.graph.factors.between import BetweenFactors, whitening
from hubodo.fuse.graph.factors.constants import COUNT, ConstantsFactor
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.factors.linear import QUADRATIC, Loss
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.factors.start import StartFactor
from hubodo.fuse.graph.fixes import usable_fixes
from hubodo.fuse.graph.graph import Fixes, GraphConfig, Headings, build
from hubodo.fuse.graph.solver import Graph, Losses, solve, solve_from_afar
from hubodo.fuse.graph.steps import OdometryPath, StepNoise, cut_path

pytest.importorskip("pyproj")

QUIET = Losses(QUADRATIC, QUADRATIC, QUADRATIC)


def wiggly_path(rng, n=200, dt=0.1):
    t = np.arange(n) * dt
    speed, yaw = 1.0 + 0.5 * np.sin(0.7 * t + rng.uniform(0, 6)), 0.6 * np.sin(0.5 * t + rng.uniform(0, 6))
    heading = np.cumsum(yaw) * dt
    return OdometryPath(
        t, np.cumsum(speed * np.cos(heading)) * dt, np.cumsum(speed * np.sin(heading)) * dt, heading
    )


def small_problem(rng, fixes=40, config=None):
    """A graph of a short drive with everything in it, and a first guess."""
    path = wiggly_path(rng)
    t = np.sort(rng.uniform(path.t[0], path.t[-1], fixes))
    e, n = (
        np.interp(t, path.t, path.x) + rng.normal(0, 1, fixes),
        np.interp(t, path.t, path.y) + rng.normal(0, 1, fixes),
    )
    config = config or GraphConfig(losses=QUIET, antenna=(0.4, -0.2))
    local = usable_fixes(Fixes(t, *gnss_drives.geodetic(e, n, 47.0, 8.0)), path.t[0], path.t[-1], 1.0, True)
    ht = np.arange(1.0, 18.0, 1.3)
    headings = Headings(ht, np.interp(ht, path.t, path.heading) + 0.05 * rng.standard_normal(len(ht)))
    return build(path, local, headings, config)


def numeric(function, at, step=1e-6):
    """Central differences of a vector function by a vector, (rows, columns)."""
    columns = []
    for k in range(len(at)):
        up, down = at.copy(), at.copy()
        up[k] += step
        down[k] -= step
        columns.append((function(up) - function(down)) / (2.0 * step))
    return np.array(columns).T


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_derivative_is_that_of_the_residual(seed):
    rng = np.random.default_rng(seed)
    problem = small_problem(rng, 12)
    graph = problem.graph
    poses = problem.poses + rng.normal(0, 0.3, problem.poses.shape)
    constants = rng.normal(0, 1, COUNT) * [0.02, 0.02, 0.01, 0.01, 0.3, 0.1]
    n = len(poses)
    for kind in (graph.between, graph.positions, graph.headings):
        item = kind.linear(poses, constants)
        rows = item.residual.size

        def residuals(z, kind=kind, rows=rows):
            return kind.linear(z[: 3 * n].reshape(n, 3), z[3 * n :]).residual.reshape(rows)

        expected = numeric(residuals, np.append(poses.ravel(), constants))
        width = item.residual.shape[1]
        found = np.zeros_like(expected)
        for i, k in enumerate(item.state):
            part = slice(i * width, (i + 1) * width)
            found[part, 3 * k : 3 * k + 3] = item.by_state[i]
            if item.by_next is not None:
                found[part, 3 * k + 3 : 3 * k + 6] = item.by_next[i]
            found[part, 3 * n :] = item.by_constants[i]
        assert np.max(np.abs(found - expected)) < 1e-6 * (1.0 + np.max(np.abs(expected)))


def test_start_and_constants_have_the_derivatives_of_their_residuals():
    start = StartFactor(1, np.array([1.0, 2.0, 0.3]), np.array([0.1, 0.2, 0.3]))
    item = start.linear(np.zeros((3, 3)))
    assert np.allclose(
        item.by_state[0], numeric(lambda p: start.linear(np.array([p * 0, p, p])).residual[0], np.zeros(3))
    )
    prior = ConstantsFactor(np.arange(6.0), np.arange(1.0, 7.0))
    found = prior.linear(np.ones(6))
    assert np.allclose(found.by_constants[0], numeric(lambda c: prior.linear(c).residual[0], np.ones(6)))


@pytest.mark.parametrize("loss", [Loss("quadratic"), Loss("huber", 4.0), Loss("bounded", 12.0)])
def test_the_cost_of_a_loss_is_the_integral_of_its_weight(loss):
    for s in (0.5, 3.9, 4.1, 11.9, 12.1, 30.0, 47.9, 48.1, 400.0):
        area, _ = quad(
            lambda u: 0.5 * float(loss.weight(np.array(u))), 0.0, s, points=[4.0, 12.0, 48.0], limit=200
        )
        assert float(loss.costs(np.array(s))) == pytest.approx(area, rel=1e-6)


def test_a_fix_far_off_pulls_not_at_all():
    loss = Losses().position
    assert loss.weight(np.array([9.0, 20.0**2])).tolist() == [1.0, 0.0]


@settings(max_examples=40)
@given(n=st.integers(1, 40), seed=st.integers(0, 1000))
def test_the_chain_solver_inverts_what_numpy_inverts(n, seed):
    rng = np.random.default_rng(seed)
    whole = np.zeros((3 * n, 3 * n))
    for k in range(n):
        j = rng.normal(size=(5, 6))
        size = 6 if k + 1 < n else 3
        whole[3 * k : 3 * k + size, 3 * k : 3 * k + size] += (j.T @ j)[:size, :size]
    whole += 0.05 * np.eye(3 * n)
    diagonal = np.array([whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(n)])
    upper = np.array([whole[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6] for k in range(n - 1)]).reshape(
        n - 1, 3, 3
    )
    right = rng.normal(size=(n, 3, 2))
    found = solve_chain(diagonal, upper, right, covariance=True)
    inverse = np.linalg.inv(whole)
    assert np.allclose(found.x.reshape(-1, 2), inverse @ right.reshape(-1, 2), atol=1e-8)
    for k in range(n):
        assert np.allclose(found.covariance[k], inverse[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], atol=1e-8)
        if k + 1 < n:
            assert np.allclose(
                found.next_covariance[k], inverse[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6], atol=1e-8
            )


def test_the_chain_keeps_its_digits_where_tenths_of_millimetres_meet_five_metres():
    """10,000 poses, the stiffest case allowed: against the closed form of a random walk observed in noise."""
    n, q, r = 10_001, 1e-8, 25.0
    diagonal, upper = np.zeros((n, 3, 3)), np.tile(-np.eye(3) / q, (n - 1, 1, 1))
    diagonal += np.eye(3) / r
    diagonal[:-1] += np.eye(3) / q
    diagonal[1:] += np.eye(3) / q
    found = solve_chain(diagonal, upper, np.zeros((n, 3, 1)), covariance=True)
    # Eigenvectors of the path graph are cosines, its eigenvalues 2 - 2 cos(pi j / n).
    j = np.arange(1, n)
    middle = (n - 1) // 2
    shape = np.sqrt(2.0 / n) * np.cos(np.pi * j * (middle + 0.5) / n)
    exact = r / n + np.sum(shape**2 / (1.0 / r + (2.0 - 2.0 * np.cos(np.pi * j / n)) / q))
    assert found.covariance[middle, 0, 0] == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("seed", [4, 5])
def test_the_optimum_and_its_covariance_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    problem = small_problem(rng)
    graph, n = problem.graph, len(problem.poses)

    def residuals(z):
        poses, constants = z[: 3 * n].reshape(n, 3), z[3 * n :]
        return np.concatenate([item.residual.ravel() for item, _ in graph.linear(poses, constants)])

    scale = np.append(np.tile([1.0, 1.0, 0.1], n), graph.constants.sigma)
    first = np.append(problem.poses.ravel(), np.zeros(COUNT))
    theirs = least_squares(
        residuals, first, jac="2-point", x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-12, max_nfev=60
    )
    ours = solve(graph, problem.poses, np.zeros(COUNT), "all")
    assert ours.converged
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-8)
    # A numeric Jacobian leaves scipy some micrometres.
    assert np.max(np.abs((np.append(ours.poses.ravel(), ours.constants) - theirs.x) / scale)) < 1e-3
    j = numeric(residuals, np.append(ours.poses.ravel(), ours.constants))
    covariance = np.linalg.inv(j.T @ j)
    for k in (0, n // 2, n - 1):
        part = slice(3 * k, 3 * k + 3)
        assert np.allclose(ours.covariance[k], covariance[part, part], rtol=1e-4, atol=1e-10)
        assert np.allclose(ours.start_covariance[k], covariance[part, :3], rtol=1e-4, atol=1e-8)
    assert np.allclose(ours.constants_covariance, covariance[3 * n :, 3 * n :], rtol=1e-3, atol=1e-12)


def test_gtsam_finds_the_same_optimum_with_robust_losses():
    pytest.importorskip("gtsam")
    from hubodo.fuse.graph.gtsam_factors import solve_with_gtsam

    rng = np.random.default_rng(6)
    problem = small_problem(rng, 60, GraphConfig(antenna=(0.4, -0.2)))
    positions = problem.graph.positions
    place = positions.place.copy()
    place[20:24] += 30.0
    graph = replace(problem.graph, positions=replace(positions, place=place))
    ours = solve_from_afar(graph, problem.poses, np.zeros(COUNT))
    shaken = ours.poses + rng.normal(0, 1, ours.poses.shape) * [0.2, 0.2, 0.02]
    poses, constants, cost = solve_with_gtsam(graph, shaken, np.zeros(COUNT))
    assert cost == pytest.approx(ours.cost, rel=1e-8)
    assert np.max(np.abs(poses - ours.poses)) < 1e-4
    assert np.max(np.abs(constants - ours.constants)) < 1e-5


def test_without_gtsam_the_error_names_the_extra_and_the_batch_still_works(monkeypatch):
    from hubodo.fuse.graph.live import LiveGraph

    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(ConfigError, match=r"pip install 'hubodo\[graph\]'"):
        LiveGraph()
    problem = small_problem(np.random.default_rng(7))
    assert solve(problem.graph, problem.poses, np.zeros(COUNT)).converged


def test_steps_put_together_are_the_odometry_itself():
    rng = np.random.default_rng(8)
    path = wiggly_path(rng)
    state_t = np.concatenate([[path.t[0]], np.sort(rng.uniform(0.1, 19.0, 30)), [path.t[-1]]])
    cut = cut_path(path, state_t, StepNoise())
    factors = BetweenFactors(cut.steps, whitening(cut.steps.covariance))
    item = factors.linear(cut.pose, np.zeros(COUNT))
    assert np.max(np.abs(item.residual)) < 1e-9
    assert np.allclose(cut.pose[:, 0], np.interp(state_t, path.t, path.x))


def test_constants_bend_the_odometry_as_an_odometer_with_those_errors_would():
    """Against the generator's odometer, which has its own integration."""
    errors = gnss_drives.Errors(scale=0.01, turn=0.02, rate=2e-3, curve=5e-3)
    rng = np.random.default_rng(9)
    drive = gnss_drives.drive(rng, gnss_drives.loop(rng, length=60.0), errors)
    path = OdometryPath(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading)
    cut = cut_path(path, np.array([path.t[0], path.t[-1]]), StepNoise())
    undo = np.array([1 / 1.01 - 1, 1 / 1.02 - 1, -2e-3 / 1.02, -5e-3 / 1.02 / 1.01, 0.0, 0.0])
    moved = complex(cut.steps.moves(undo).sum()) * np.exp(1j * drive.heading[0])
    x, y, heading = drive.truth(path.t[-1])
    assert abs(moved - (x + 1j * y)) < 2e-3
    assert float(cut.steps.turns(undo)[0]) == pytest.approx(heading - drive.heading[0], abs=1e-3)


def test_the_covariance_of_a_stretch_is_that_of_many_noisy_ones():
    rng = np.random.default_rng(10)
    path = wiggly_path(rng, 60)
    noise = StepNoise(along=0.02, sideways=0.01, heading=0.02, heading_way=0.0)
    ends = np.array([path.t[0], path.t[-1]])
    expected = cut_path(path, ends, noise).steps.covariance[0]
    step = np.diff(path.x + 1j * path.y) * np.exp(-0.5j * (path.heading[1:] + path.heading[:-1]))
    turn = np.diff(path.heading)
    made = []
    for _ in range(4000):
        root = np.sqrt(np.abs(step))
        noisy = step + root * (0.02 * rng.standard_normal(59) + 0.01j * rng.standard_normal(59))
        course = path.heading[0] + np.append(
            0.0, np.cumsum(turn + 0.02 * np.sqrt(0.1) * rng.standard_normal(59))
        )
        end = np.sum(noisy * np.exp(0.5j * (course[1:] + course[:-1]))) * np.exp(-1j * path.heading[0])
        made.append([end.real, end.imag, course[-1]])
    found = np.cov(np.array(made).T)
    # 4000 draws: the standard error of a variance is 2.2 %; four of them.
    assert np.allclose(np.diag(found), np.diag(expected), rtol=0.09)
    scale = np.sqrt(np.diag(expected))
    assert np.allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.09)


def test_finer_odometry_gives_the_same_covariance():
    path = wiggly_path(np.random.default_rng(11), 100)
    fine_t = np.linspace(path.t[0], path.t[-1], 991)
    fine = OdometryPath(fine_t, *(np.interp(fine_t, path.t, v) for v in (path.x, path.y, path.heading)))
    ends = np.array([path.t[0], 4.05, path.t[-1]])
    coarse, other = (cut_path(p, ends, StepNoise()).steps.covariance for p in (path, fine))
    assert np.allclose(coarse, other, rtol=0.02, atol=1e-9)


def test_turning_the_world_turns_the_solution():
    rng = np.random.default_rng(12)
    problem = small_problem(rng)
    graph = problem.graph
    turn, c, s = 1.1, np.cos(1.1), np.sin(1.1)
    matrix = np.array([[c, -s], [s, c]])
    turned = replace(
        graph,
        positions=PositionFactors(
            graph.positions.state,
            graph.positions.place @ matrix.T,
            graph.positions.sigma,
            graph.positions.velocity,
            graph.positions.antenna,
        ),
        headings=HeadingFactors(graph.headings.state, graph.headings.heading + turn, graph.headings.sigma),
        start=replace(graph.start, mean=np.append(matrix @ graph.start.mean[:2], graph.start.mean[2] + turn)),
    )  # fmt: skip
    first = solve(graph, problem.poses, np.zeros(COUNT))
    poses = np.column_stack([problem.poses[:, :2] @ matrix.T, problem.poses[:, 2] + turn])
    second = solve(turned, poses, np.zeros(COUNT))
    assert np.allclose(second.poses[:, :2], first.poses[:, :2] @ matrix.T, atol=1e-5)
    assert np.allclose(second.constants, first.constants, atol=1e-7)


def test_a_graph_without_fixes_and_headings_is_the_odometry():
    path = wiggly_path(np.random.default_rng(13))
    problem = build(path, None, None, GraphConfig())
    assert isinstance(problem.graph, Graph)
    found = solve(problem.graph, problem.poses, np.zeros(COUNT))
    assert np.allclose(found.poses, problem.cut.pose, atol=1e-9)
