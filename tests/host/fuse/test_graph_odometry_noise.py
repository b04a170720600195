"""Variance components of the odometry's noise, estimated from fixes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import wanted
from accuracy import car_gnss
from graph_drives import errors_of, fixes_of, make, numeric, path_of, rms, small_drive
from hubodo.fuse.graph import odometry_noise
from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import GNSS_DELAY, N_CONSTANTS
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.odometry_steps import StepNoise
from hubodo.fuse.graph.solver import solve_graph
from hubodo.fuse.track import Track


def noisier(path, rng, along, sideways, heading):
    """Return a path with noise in its steps: m, m and rad per √m along, across and in heading."""
    place, head = path.x + 1j * path.y, np.unwrap(path.heading)
    distance = np.diff(place) * np.exp(-0.5j * (head[1:] + head[:-1]))
    root = np.sqrt(np.abs(distance))
    white = rng.standard_normal((3, len(distance)))
    distance = distance + root * (along * white[0] + 1j * sideways * white[1])
    head = head[0] + np.append(0.0, np.cumsum(np.diff(head) + heading * root * white[2]))
    place = place[0] + np.append(0.0, np.cumsum(distance * np.exp(0.5j * (head[1:] + head[:-1]))))
    return Track(path.t, place.real, place.imag, head)


def test_precise_fixes_identify_each_noise_component():
    base = StepNoise(heading=0.0, heading_per_distance=2e-3)
    wanted_noise = np.array([0.08, 0.02, 8e-3])
    result = []
    for seed in range(3):
        drive = make(seed, sigma=0.05)
        path = noisier(path_of(drive), np.random.default_rng([seed, 71]), *wanted_noise)
        noise = fuse_graph(path, fixes_of(drive, sigma=0.05), None, GraphConfig(noise=base)).noise
        result.append(np.array(noise.sigma_factors) * [base.along, base.sideways, base.heading_per_distance])
    # 250 m determine a variance per metre to a tenth, less where the fixes' noise masks it.
    assert np.mean(result, axis=0) == pytest.approx(wanted_noise, rel=0.3)


@pytest.mark.parametrize("hours", [0.5, 3.0])
def test_sections_reach_from_the_first_fix_to_the_last(hours):
    t = np.arange(0.0, 3600.0 * hours, 2.0)
    good = np.arange(5, len(t) - 5)
    result = odometry_noise._choose_sections(good, t)
    assert 3 <= len(result) <= 4
    assert result[0][0] == good[0] and result[-1][-1] == good[-1]
    middles = [np.mean(t[one]) for one in result]
    # Ten minutes each, evenly spaced except for one section.
    assert all(np.ptp(t[one]) == pytest.approx(600.0, abs=10.0) for one in result)
    assert np.ptp(np.diff(middles)) <= 600.0


def test_sections_do_not_overlap_and_have_at_least_thirty_fixes():
    t = np.arange(0.0, 2000.0, 5.0)
    full = np.concatenate(odometry_noise._choose_sections(np.arange(len(t)), t))
    assert full.tolist() == list(range(len(t)))
    for retained, count in ((30, 4), (29, 3)):
        # The second quarter has that many good fixes.
        good = np.delete(np.arange(len(t)), np.arange(100 + retained, 200))
        assert len(odometry_noise._choose_sections(good, t)) == count


@pytest.fixture(scope="module")
def solved():
    """Return a solved graph of 85 fixes with different sigmas."""
    rng = np.random.default_rng(14)
    drive = small_drive(rng, fixes=100, config=GraphConfig(antenna=(0.0, 0.0)))
    output = (
        replace(item, sigma=rng.uniform(0.5, 2.0, 100)) if isinstance(item, PositionFactors) else item
        for item in drive.graph.factors
    )
    graph = FactorGraph(tuple(output))
    result = solve_graph(graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    # Constants far from zero, except for the delay, which would couple the fix's position with the heading.
    constants = np.array([0.02, -0.03, 0.004, 0.002, 0.0, 0.05])
    assert GNSS_DELAY == 4
    return graph, replace(result, constants=constants), drive.odometry.pose_t


def test_the_components_are_the_covariance_of_odometry_noise_at_the_fixes(solved):
    """The reference compounds the increments, each perturbed a little forward, left and in heading."""
    graph, solution, state_t = solved
    between, fixes = graph.find_group(BetweenFactors), graph.find_group(PositionFactors)
    rows, observed = (item.linearise(solution.poses, solution.constants) for item in (between, fixes))
    chosen, prior = np.arange(10, 95), np.array([0.01, 0.02, 1e-3, 2e-3, 0.3, 0.4])
    result = odometry_noise._model_section(
        chosen, observed, fixes.sigma, rows, between, solution, state_t, prior
    )
    state = fixes.pose_index[chosen]
    first, last = int(state[0]), int(state[-1])
    steps = between.steps
    gap = np.diff(solution.poses, axis=0)
    ahead = np.exp(1j * solution.poses[:-1, 2])
    distance = (gap[:, 0] + 1j * gap[:, 1]) / ahead
    reported = np.add.reduceat(steps.correct_displacements(solution.constants), steps.first_step)
    noise = np.column_stack(
        [
            (distance - reported).real,
            (distance - reported).imag,
            gap[:, 2] - steps.correct_turns(solution.constants),
        ]
    )
    edges = np.linspace(0, len(chosen), 61).astype(int)

    def means(pushed, constants, start):
        """Return the positions of averaged fixes, east above north."""
        moves = (
            np.add.reduceat(steps.correct_displacements(constants), steps.first_step)
            + pushed[:, 0]
            + 1j * pushed[:, 1]
        )
        turns = steps.correct_turns(constants) + pushed[:, 2]
        pose = solution.poses[first] + start
        heading = pose[2] + np.append(0.0, np.cumsum(turns[first:last]))
        place = complex(*pose[:2]) + np.append(0.0, np.cumsum(moves[first:last] * np.exp(1j * heading[:-1])))
        velocity = fixes.velocity[chosen] @ [1.0, 1j]
        at = place[state - first] + np.exp(1j * heading[state - first]) * constants[GNSS_DELAY] * velocity
        return blocks(at)

    def blocks(at):
        share = fixes.sigma[chosen] ** -2.0
        mean = np.add.reduceat(share * at, edges[:-1]) / np.add.reduceat(share, edges[:-1])
        return np.concatenate([mean.real, mean.imag])

    def by(size, change):
        return numeric(lambda v: means(*change(v)), np.zeros(size), 1e-5)

    constants = solution.constants
    pushed = by(
        3 * (last - first),
        lambda v: (
            noise + np.pad(v.reshape(-1, 3), ((first, len(noise) - last), (0, 0))),
            constants,
            np.zeros(3),
        ),
    )
    by_constants = by(N_CONSTANTS, lambda v: (noise, constants + v, np.zeros(3)))
    by_start = by(3, lambda v: (noise, constants, v))
    variances = np.einsum("kii->ki", steps.covariance[first:last])
    for part, axis in zip(result.unit_covariances, range(3), strict=False):
        lever = pushed[:, axis::3] * np.sqrt(variances[:, axis])
        np.testing.assert_allclose(part, lever @ lever.T, rtol=1e-5, atol=1e-9 * np.abs(part).max())
    certain = by_constants * prior, by_start * [30.0, 30.0, 0.5]
    expected = sum(lever @ lever.T for lever in certain)
    np.testing.assert_allclose(result.start_covariance, expected, rtol=1e-5, atol=1e-9 * expected.max())
    measured = blocks(fixes.position[chosen] @ [1.0, 1j])
    alone = measured - means(noise, constants, np.zeros(3))
    alone += pushed @ noise[first:last].ravel() + by_constants @ constants
    assert result.y == pytest.approx(alone, abs=1e-6)


def test_fix_errors_have_a_white_and_a_correlated_component(solved):
    graph, solution, state_t = solved
    between, fixes = graph.find_group(BetweenFactors), graph.find_group(PositionFactors)
    rows, observed = (item.linearise(solution.poses, solution.constants) for item in (between, fixes))
    chosen = np.arange(40)
    result = odometry_noise._model_section(
        chosen, observed, fixes.sigma, rows, between, solution, state_t, np.ones(N_CONSTANTS)
    )
    # With fewer than sixty fixes each is a block of its own.
    sigma, t = fixes.sigma[:40], state_t[fixes.pose_index[:40]]
    assert result.unit_covariances[3] == pytest.approx(np.diag(np.tile(sigma**2, 2)))
    for part, lasts in zip(result.unit_covariances[4:], (15.0, 150.0), strict=True):
        repeats = (0.05 * np.median(sigma)) ** 2 * np.exp(-np.abs(np.subtract.outer(t, t)) / lasts)
        nothing = np.zeros_like(repeats)
        assert part == pytest.approx(np.block([[repeats, nothing], [nothing, repeats]]))


def test_with_too_few_used_fixes_the_noise_is_unchanged(solved, monkeypatch):
    """The factor is the root of the most likely variance where there are enough fixes."""
    logs = 2.0 * np.log([2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    monkeypatch.setattr(odometry_noise, "_average_modes", lambda observed: logs)
    graph, solution, state_t = solved
    fixes = graph.find_group(PositionFactors)
    remaining = tuple(factor for factor in graph.factors if factor is not fixes)
    for count, times in ((30, [2.0, 3.0, 4.0]), (29, [1.0, 1.0, 1.0])):
        place = fixes.position.copy()
        place[count:] += 1e3
        some = FactorGraph((*remaining, replace(fixes, position=place)))
        result = odometry_noise.estimate_noise_factors(some, solution, state_t, np.ones(N_CONSTANTS))
        assert result.tolist() == pytest.approx(times)
    for without in (FactorGraph(remaining), FactorGraph((fixes,))):
        assert (
            odometry_noise.estimate_noise_factors(without, solution, state_t, np.ones(N_CONSTANTS)).tolist()
            == [1.0] * 3
        )


def alone(count, squares):
    """Return a model of the noise along only: `count` white numbers with that sum of squares."""
    parts = np.zeros((6, count, count))
    parts[0] = np.eye(count)
    return odometry_noise._SectionModel(
        np.full(count, np.sqrt(squares / count)), np.zeros((count, count)), parts
    )


def cost(log, count, squares):
    """Return the negative log posterior; a factor of two is one sigma of the logarithm."""
    return 0.5 * (log / 1.4) ** 2 + 0.5 * count * log + 0.5 * squares * np.exp(-log)


@pytest.mark.parametrize("logarithm", [3.0, 1.0, -3.0])
def test_the_noise_maximises_likelihood_and_prior(logarithm):
    count, squares = 30, 30 * np.exp(logarithm)
    best = minimize_scalar(cost, args=(count, squares)).x
    result = odometry_noise._average_modes([alone(count, squares)])
    assert result[0] == pytest.approx(best, abs=0.02)
    assert np.abs(result[1:]).max() < 0.1
    # Two sections carry the information of one twice as long.
    best = minimize_scalar(cost, args=(2 * count, 2 * squares)).x
    assert odometry_noise._average_modes([alone(count, squares)] * 2)[0] == pytest.approx(best, abs=0.02)
    assert odometry_noise._average_modes([]).tolist() == [0.0] * 6


def test_less_noise_than_expected_is_accepted_at_two_sigma():
    def gain(squares):
        return cost(0.0, 20, squares) - minimize_scalar(cost, args=(20, squares)).fun

    for wanted_gain, shrinks in ((1.8, False), (2.2, True)):
        squares = brentq(lambda s, by=wanted_gain: gain(s) - by, 0.1, 20.0)
        assert (odometry_noise._average_modes([alone(20, squares)])[0] < -0.5) == shrinks


def test_the_gradient_of_the_posterior_is_its_numerical_derivative(monkeypatch):
    observed = []
    likely = odometry_noise._average_modes
    monkeypatch.setattr(odometry_noise, "_average_modes", lambda item: observed.append(item) or likely(item))
    drive = make(4)
    fuse_graph(path_of(drive), fixes_of(drive))
    logs = np.array([1.0, -1.0, 2.0, 0.1, 3.0, -2.0])
    _, slope = odometry_noise._negative_log_posterior(logs, observed[0])
    assert slope == pytest.approx(
        numeric(lambda v: np.array([odometry_noise._negative_log_posterior(v, observed[0])[0]]), logs)[0],
        rel=1e-4,
        abs=1e-5,
    )


def test_a_drifting_heading_is_detected_with_fixes_of_five_metres():
    honest, bold = [], []
    for seed in range(4):
        drive = make(seed)
        path = noisier(path_of(drive), np.random.default_rng([seed, 72]), 0.0, 0.0, 0.02)
        for reported, config in ((honest, GraphConfig()), (bold, GraphConfig(inflate_sigmas=False))):
            result = fuse_graph(path, fixes_of(drive), None, config)
            error = errors_of(drive, result)
            sigma = np.column_stack([result.track.sigma_x, result.track.sigma_y])
            reported.append((rms(error), np.mean(np.sum((error[:, :2] / sigma) ** 2, axis=1))))
    assert np.mean(bold, axis=0)[1] > 4.0
    assert 0.7 * 2 < np.mean(honest, axis=0)[1] < 2 * 2
    assert np.mean(honest, axis=0)[0] < np.mean(bold, axis=0)[0]


def test_on_a_real_car_with_fixes_of_five_metres_errors_agree_with_sigmas():
    wanted.recording("car")
    for path, constants, truth in car_gnss.paths([("right",)]).values():
        rows = [car_gnss.one(path, constants, truth, seed, 0.0) for seed in range(3)]
        error, nees, fixes = np.mean(rows, axis=0)
        assert error < 0.7 < 0.1 * fixes
        assert nees < 4.0
