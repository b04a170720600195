"""Variance components of the odometry noise, estimated from fixes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import wanted
from accuracy import car_gnss
from graph_drives import (
    central_differences,
    drive_fixes,
    odometry_path,
    position_rms,
    simulate_drive,
    small_drive_graph,
    track_errors,
)
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
from repetitions import first_and_more


def add_noise(path, rng, along, sideways, heading):
    """Return a path with step noise along, sideways (m/√m) and in heading (rad/√m)."""
    position, heading_angle = path.x + 1j * path.y, np.unwrap(path.heading)
    distance = np.diff(position) * np.exp(-0.5j * (heading_angle[1:] + heading_angle[:-1]))
    root_length = np.sqrt(np.abs(distance))
    noise = rng.standard_normal((3, len(distance)))
    distance = distance + root_length * (along * noise[0] + 1j * sideways * noise[1])
    heading_angle = heading_angle[0] + np.append(
        0.0, np.cumsum(np.diff(heading_angle) + heading * root_length * noise[2])
    )
    position = position[0] + np.append(
        0.0, np.cumsum(distance * np.exp(0.5j * (heading_angle[1:] + heading_angle[:-1])))
    )
    return Track(path.t, position.real, position.imag, heading_angle)


def test_precise_fixes_identify_each_noise_component():
    base = StepNoise(heading=0.0, heading_per_distance=2e-3)
    true_noise = np.array([0.08, 0.02, 8e-3])
    estimates = []
    for seed in range(3):
        drive = simulate_drive(seed, sigma=0.05)
        path = add_noise(odometry_path(drive), np.random.default_rng([seed, 71]), *true_noise)
        noise = fuse_graph(path, drive_fixes(drive, sigma=0.05), None, GraphConfig(noise=base)).noise
        estimates.append(
            np.array(noise.sigma_factors) * [base.along, base.sideways, base.heading_per_distance]
        )
    # A drive of 250 m determines a variance per metre to 10 %, less where the noise of the fixes masks it.
    assert np.mean(estimates, axis=0) == pytest.approx(true_noise, rel=0.3)


@pytest.mark.parametrize("hours", [0.5, 3.0])
def test_sections_reach_from_the_first_fix_to_the_last(hours):
    t = np.arange(0.0, 3600.0 * hours, 2.0)
    good = np.arange(5, len(t) - 5)
    sections = odometry_noise._choose_sections(good, t)
    assert 3 <= len(sections) <= 4
    assert sections[0][0] == good[0] and sections[-1][-1] == good[-1]
    middles = [np.mean(t[section]) for section in sections]
    # Ten minutes each, evenly spaced except for one section.
    assert all(np.ptp(t[section]) == pytest.approx(600.0, abs=10.0) for section in sections)
    assert np.ptp(np.diff(middles)) <= 600.0


def test_sections_do_not_overlap_and_have_at_least_thirty_fixes():
    t = np.arange(0.0, 2000.0, 5.0)
    full = np.concatenate(odometry_noise._choose_sections(np.arange(len(t)), t))
    assert full.tolist() == list(range(len(t)))
    for n_good, count in ((30, 4), (29, 3)):
        # The second quarter has that many good fixes.
        good = np.delete(np.arange(len(t)), np.arange(100 + n_good, 200))
        assert len(odometry_noise._choose_sections(good, t)) == count


@pytest.fixture(scope="module")
def solved_graph():
    """Return a solved graph of 85 fixes with different sigmas."""
    rng = np.random.default_rng(14)
    drive = small_drive_graph(rng, n_fixes=100, config=GraphConfig(antenna=(0.0, 0.0)))
    factors = (
        replace(item, sigma=rng.uniform(0.5, 2.0, 100)) if isinstance(item, PositionFactors) else item
        for item in drive.graph.factors
    )
    graph = FactorGraph(tuple(factors))
    result = solve_graph(graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    # Constants are far from zero, except for the delay, which would couple position and heading of a fix.
    constants = np.array([0.02, -0.03, 0.004, 0.002, 0.0, 0.05, 0.0, 0.0, 0.0, 0.0])
    assert GNSS_DELAY == 4
    return graph, replace(result, constants=constants), drive.odometry.pose_t


def test_the_components_are_the_covariance_of_odometry_noise_at_the_fixes(solved_graph):
    """The reference compounds the increments, each perturbed forward, to the left and in heading."""
    graph, solution, state_t = solved_graph
    between, fixes = graph.find_group(BetweenFactors), graph.find_group(PositionFactors)
    rows, observed = (item.linearise(solution.poses, solution.constants) for item in (between, fixes))
    chosen, prior = np.arange(10, 95), np.array([0.01, 0.02, 1e-3, 2e-3, 0.3, 0.4, 0.1, 0.1, 0.1, 0.1])
    result = odometry_noise._model_section(
        chosen, observed, fixes.sigma, rows, between, solution, state_t, prior
    )
    state = fixes.pose_index[chosen]
    first, last = int(state[0]), int(state[-1])
    steps = between.steps
    difference = np.diff(solution.poses, axis=0)
    direction = np.exp(1j * solution.poses[:-1, 2])
    distance = (difference[:, 0] + 1j * difference[:, 1]) / direction
    odometry_displacement = np.add.reduceat(steps.correct_displacements(solution.constants), steps.first_step)
    noise = np.column_stack(
        [
            (distance - odometry_displacement).real,
            (distance - odometry_displacement).imag,
            difference[:, 2] - steps.correct_turns(solution.constants),
        ]
    )
    edges = np.linspace(0, len(chosen), 61).astype(int)

    def averaged_positions(by_steps, constants, start):
        """Return the positions of averaged fixes, east above north."""
        displacements = (
            np.add.reduceat(steps.correct_displacements(constants), steps.first_step)
            + by_steps[:, 0]
            + 1j * by_steps[:, 1]
        )
        turns = steps.correct_turns(constants) + by_steps[:, 2]
        pose = solution.poses[first] + start
        heading = pose[2] + np.append(0.0, np.cumsum(turns[first:last]))
        place = complex(*pose[:2]) + np.append(
            0.0, np.cumsum(displacements[first:last] * np.exp(1j * heading[:-1]))
        )
        velocity = fixes.velocity[chosen] @ [1.0, 1j]
        antenna = (
            place[state - first] + np.exp(1j * heading[state - first]) * constants[GNSS_DELAY] * velocity
        )
        return block_means(antenna)

    def block_means(antenna):
        information = fixes.sigma[chosen] ** -2.0
        mean = np.add.reduceat(information * antenna, edges[:-1]) / np.add.reduceat(information, edges[:-1])
        return np.concatenate([mean.real, mean.imag])

    def derivative(size, change):
        return central_differences(lambda v: averaged_positions(*change(v)), np.zeros(size), 1e-5)

    constants = solution.constants
    by_steps = derivative(
        3 * (last - first),
        lambda v: (
            noise + np.pad(v.reshape(-1, 3), ((first, len(noise) - last), (0, 0))),
            constants,
            np.zeros(3),
        ),
    )
    by_constants = derivative(N_CONSTANTS, lambda v: (noise, constants + v, np.zeros(3)))
    by_start = derivative(3, lambda v: (noise, constants, v))
    variances = np.einsum("kii->ki", steps.covariance[first:last])
    for part, axis in zip(result.unit_covariances, range(3), strict=False):
        sensitivity = by_steps[:, axis::3] * np.sqrt(variances[:, axis])
        np.testing.assert_allclose(
            part, sensitivity @ sensitivity.T, rtol=1e-5, atol=1e-9 * np.abs(part).max()
        )
    by_prior = by_constants * prior, by_start * [30.0, 30.0, 0.5]
    expected = sum(sensitivity @ sensitivity.T for sensitivity in by_prior)
    np.testing.assert_allclose(result.start_covariance, expected, rtol=1e-5, atol=1e-9 * expected.max())
    measured = block_means(fixes.position[chosen] @ [1.0, 1j])
    without_noise = measured - averaged_positions(noise, constants, np.zeros(3))
    without_noise += by_steps @ noise[first:last].ravel() + by_constants @ constants
    assert result.y == pytest.approx(without_noise, abs=1e-6)


def test_fix_errors_have_a_white_and_a_correlated_component(solved_graph):
    graph, solution, state_t = solved_graph
    between, fixes = graph.find_group(BetweenFactors), graph.find_group(PositionFactors)
    rows, observed = (item.linearise(solution.poses, solution.constants) for item in (between, fixes))
    chosen = np.arange(40)
    result = odometry_noise._model_section(
        chosen, observed, fixes.sigma, rows, between, solution, state_t, np.ones(N_CONSTANTS)
    )
    # With fewer than sixty fixes each is a block of its own.
    sigma, t = fixes.sigma[:40], state_t[fixes.pose_index[:40]]
    assert result.unit_covariances[3] == pytest.approx(np.diag(np.tile(sigma**2, 2)))
    for part, correlation_time in zip(result.unit_covariances[4:], (15.0, 150.0), strict=True):
        correlated = (0.05 * np.median(sigma)) ** 2 * np.exp(
            -np.abs(np.subtract.outer(t, t)) / correlation_time
        )
        zeros = np.zeros_like(correlated)
        assert part == pytest.approx(np.block([[correlated, zeros], [zeros, correlated]]))


def test_with_too_few_used_fixes_the_noise_is_unchanged(solved_graph, monkeypatch):
    """The factor is the square root of the most likely variance if there are enough fixes."""
    logs = 2.0 * np.log([2.0, 3.0, 4.0, 5.0, 6.0, 7.0])
    monkeypatch.setattr(odometry_noise, "_average_modes", lambda observed: logs)
    graph, solution, state_t = solved_graph
    fixes = graph.find_group(PositionFactors)
    remaining = tuple(factor for factor in graph.factors if factor is not fixes)
    for count, factors in ((30, [2.0, 3.0, 4.0]), (29, [1.0, 1.0, 1.0])):
        position = fixes.position.copy()
        position[count:] += 1e3
        graph_of_count = FactorGraph((*remaining, replace(fixes, position=position)))
        result = odometry_noise.estimate_noise_factors(
            graph_of_count, solution, state_t, np.ones(N_CONSTANTS)
        )
        assert result.tolist() == pytest.approx(factors)
    for without in (FactorGraph(remaining), FactorGraph((fixes,))):
        assert (
            odometry_noise.estimate_noise_factors(without, solution, state_t, np.ones(N_CONSTANTS)).tolist()
            == [1.0] * 3
        )


def single_component_model(count, squares):
    """Return a model of noise along the path only: `count` equal values with that sum of squares."""
    parts = np.zeros((6, count, count))
    parts[0] = np.eye(count)
    return odometry_noise._SectionModel(
        np.full(count, np.sqrt(squares / count)), np.zeros((count, count)), parts
    )


def cost(log, count, squares):
    """Return the negative log posterior; the prior has a sigma of 1.4 in the logarithm, a factor of two in
    sigma.
    """
    return 0.5 * (log / 1.4) ** 2 + 0.5 * count * log + 0.5 * squares * np.exp(-log)


@pytest.mark.parametrize("logarithm", [3.0, 1.0, -3.0])
def test_the_noise_maximises_likelihood_and_prior(logarithm):
    count, squares = 30, 30 * np.exp(logarithm)
    best = minimize_scalar(cost, args=(count, squares)).x
    result = odometry_noise._average_modes([single_component_model(count, squares)])
    assert result[0] == pytest.approx(best, abs=0.02)
    assert np.abs(result[1:]).max() < 0.1
    # Two sections carry the information of one twice as long.
    best = minimize_scalar(cost, args=(2 * count, 2 * squares)).x
    assert odometry_noise._average_modes([single_component_model(count, squares)] * 2)[0] == pytest.approx(
        best, abs=0.02
    )
    assert odometry_noise._average_modes([]).tolist() == [0.0] * 6


def test_less_noise_than_expected_is_accepted_at_two_sigma():
    def gain(squares):
        return cost(0.0, 20, squares) - minimize_scalar(cost, args=(20, squares)).fun

    for log_likelihood_gain, accepted in ((1.8, False), (2.2, True)):
        squares = brentq(lambda s, by=log_likelihood_gain: gain(s) - by, 0.1, 20.0)
        assert (odometry_noise._average_modes([single_component_model(20, squares)])[0] < -0.5) == accepted


def test_the_gradient_of_the_posterior_is_its_numerical_derivative(monkeypatch):
    models = []
    average_modes = odometry_noise._average_modes
    monkeypatch.setattr(
        odometry_noise, "_average_modes", lambda item: models.append(item) or average_modes(item)
    )
    drive = simulate_drive(4)
    fuse_graph(odometry_path(drive), drive_fixes(drive))
    logs = np.array([1.0, -1.0, 2.0, 0.1, 3.0, -2.0])
    _, gradient = odometry_noise._negative_log_posterior(logs, models[0])
    assert gradient == pytest.approx(
        central_differences(
            lambda v: np.array([odometry_noise._negative_log_posterior(v, models[0])[0]]), logs
        )[0],
        rel=1e-4,
        abs=1e-5,
    )


@pytest.mark.parametrize("seeds", first_and_more(range(2), range(4)), ids=str)
def test_heading_drift_is_covered_by_sigma_with_fixes_of_five_metres(seeds):
    inflated, not_inflated = [], []
    for seed in seeds:
        drive = simulate_drive(seed)
        path = add_noise(odometry_path(drive), np.random.default_rng([seed, 72]), 0.0, 0.0, 0.02)
        for rows, config in ((inflated, GraphConfig()), (not_inflated, GraphConfig(inflate_sigmas=False))):
            result = fuse_graph(path, drive_fixes(drive), None, config)
            error = track_errors(drive, result)
            sigma = np.column_stack([result.track.sigma_x, result.track.sigma_y])
            rows.append((position_rms(error), np.mean(np.sum((error[:, :2] / sigma) ** 2, axis=1))))
    assert np.mean(not_inflated, axis=0)[1] > 4.0
    assert 0.7 * 2 < np.mean(inflated, axis=0)[1] < 2 * 2
    assert np.mean(inflated, axis=0)[0] < np.mean(not_inflated, axis=0)[0]


@pytest.mark.parametrize("seeds", first_and_more(range(1), range(3)), ids=str)
def test_on_a_real_car_errors_agree_with_sigma_for_fixes_of_five_metres(seeds):
    wanted.recording("car")
    for path, constants, truth in car_gnss.paths([("right",)]).values():
        rows = [car_gnss.fuse_drive(path, constants, truth, seed, 0.0) for seed in seeds]
        error, nees, fixes = np.mean(rows, axis=0)
        assert error < 0.7 < 0.1 * fixes
        assert nees < 4.0
