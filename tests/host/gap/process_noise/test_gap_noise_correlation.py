"""Correlation of the noise: whitening within windows, slow noise, and what missing effects do to both."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz

from coloured_noise import (
    NOISE_SIGMA,
    SLOW_RATIO,
    SLOW_TIME,
    compute_resonance_covariance,
    with_coloured_noise,
)
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.noise_correlation import correlate_noise
from hubodo.gap.process_noise.segments import find_standing_windows, window_edges, window_grid
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.refit.linear_fit import linearise_fit
from hubodo.gap.state.state import stack_channels
from hubodo.gap.state.terms import ModelTerm
from repetitions import first_and_more

GYRO_X = 0


def correlate(state):
    tracked, _walks = track_wheel_phase(state)
    return correlate_noise(Evaluation(tracked, estimate_weights(tracked)))


def test_white_noise_is_left_as_it_is(long_evaluation):
    assert not correlate_noise(long_evaluation).weights.is_correlated


def test_samples_that_come_in_bursts_show_no_correlation(long_evaluation):
    state = with_coloured_noise(long_evaluation, np.random.default_rng(4), slow_ratio=0.0)
    nodes = [
        replace(node, t=np.where(np.abs(node.t - 80.0) < 1.0, 80.0 + 1e-3 * (node.t - 80.0), node.t))
        for node in state.problem.nodes
    ]
    bursts = replace(state, problem=replace(state.problem, nodes=tuple(nodes)))
    assert not correlate(bursts).weights.is_correlated


def test_whitening_makes_the_covariance_of_a_resonance_the_identity(long_evaluation):
    coloured = correlate(with_coloured_noise(long_evaluation, np.random.default_rng(1), slow_ratio=0.0))
    assert set(coloured.weights.correlations) == {"left", "right"}
    for name, correlation in coloured.weights.correlations.items():
        assert not correlation.slow_noise
        whitening = correlation.whitening[0, GYRO_X]
        own, given = (
            weights.noise[name].sigma[GYRO_X] for weights in (coloured.weights, long_evaluation.weights)
        )
        ratio = NOISE_SIGMA * float(given.mean()) / float(np.median(own))
        covariance = toeplitz(compute_resonance_covariance(len(whitening))) * ratio**2
        white = whitening @ covariance @ whitening.T
        # The log determines each element within some percent.
        np.testing.assert_allclose(white, np.eye(len(white)), atol=0.2)


def test_noise_of_a_wheel_that_stands_is_whitened_apart_from_that_of_driving(long_evaluation):
    """Vibration has lines that a standing wheel lacks: its means would seem 20 times more certain."""
    state = with_coloured_noise(long_evaluation, np.random.default_rng(5), slow_ratio=0.0)
    rng, nodes = np.random.default_rng(6), []
    for node in state.problem.nodes:
        edges = window_edges(window_grid(state.problem), node)
        is_standing = np.repeat(find_standing_windows(node, edges), np.diff(edges))
        assert 0.05 < is_standing.mean() < 0.2
        sigma = NOISE_SIGMA * long_evaluation.weights.noise[node.name].sigma.mean(axis=1, keepdims=True)
        quiet = stack_channels(long_evaluation.state.predictions[node.name])
        quiet += sigma * rng.standard_normal(quiet.shape)
        nodes.append(replace(node, y=np.where(is_standing, quiet, node.y)))
    coloured = correlate(replace(state, problem=replace(state.problem, nodes=tuple(nodes))))
    for correlation in coloured.weights.correlations.values():
        driving, standing = correlation.whitening[:, GYRO_X]
        resonance = toeplitz(compute_resonance_covariance(len(driving)))
        white = driving @ resonance @ driving.T, standing @ standing.T
        for covariance, tolerance in zip(white, (0.1, 0.3), strict=True):
            # Its size is that of the noise of each group of samples; 800 samples of a standing wheel scatter.
            size = float(np.mean(np.diag(covariance)))
            np.testing.assert_allclose(covariance / size, np.eye(len(driving)), atol=tolerance)
        assert np.abs(driving @ driving.T).max() > 2.0 * np.abs(standing @ standing.T).max()


def test_slow_noise_that_turns_with_the_wheel_has_its_size_and_duration(long_evaluation):
    coloured = correlate(with_coloured_noise(long_evaluation, np.random.default_rng(2)))
    for name, correlation in coloured.weights.correlations.items():
        expected = NOISE_SIGMA * SLOW_RATIO * long_evaluation.weights.noise[name].sigma.mean(axis=1)
        turning = [one for one in correlation.slow_noise if one.carrier != "constant"]
        ratios = [one.sigma / expected[one.row] for one in turning]
        times = [one.correlation_time for one in turning]
        print(name, np.round(ratios, 2), times)
        assert len(turning) == 12
        assert 0.6 < np.median(ratios) < 1.5
        assert SLOW_TIME / 3.0 < np.median(times) < 3.0 * SLOW_TIME


def test_a_missing_effect_hardly_changes_the_whitening(long_evaluation):
    """A bias and a wave once per turn with more power than the noise in their bands change little."""
    angle = long_evaluation.state.predictions["left"].rolling.angle
    whitening = []
    for added in (0.0, 0.3 * (1.0 + np.cos(angle))[None]):
        state = with_coloured_noise(
            long_evaluation, np.random.default_rng(3), slow_ratio=0.0, added={"left": added}
        )
        whitening.append(correlate(state).weights.correlations["left"].whitening[0, GYRO_X])
    assert np.abs(whitening[0] - whitening[1]).max() < 0.05 * np.abs(whitening[0]).max()


@pytest.mark.parametrize(("n_seeds", "slow_ratio"), first_and_more((8, 0.0), (40, 0.0), (40, SLOW_RATIO)))
def test_the_sigmas_of_absent_effects_in_coloured_noise_are_their_scatter(
    long_evaluation, n_seeds, slow_ratio
):
    """NEES is near 1 with the correlation of the noise; white weights make it 20 times smaller or larger."""
    squares = {True: [], False: []}
    for seed in range(n_seeds):
        state = with_coloured_noise(long_evaluation, np.random.default_rng(100 + seed), slow_ratio=slow_ratio)
        correlated = correlate(state)
        white = replace(correlated, weights=replace(correlated.weights, correlations={}))
        for name in ("gyro_bias", "accel_bias", "node_misalignment"):
            term = ModelTerm(BY_NAME[name](), "left", is_fitted=True)
            for evaluation in (correlated, white):
                fit = linearise_fit(evaluation.with_state(evaluation.state.with_term(term)))
                is_observed = np.diag(fit.covariance) > 0.0
                step = fit.step[: len(is_observed)][is_observed]
                covariance = fit.covariance[np.ix_(is_observed, is_observed)]
                squares[evaluation.weights.is_correlated].append(
                    step @ np.linalg.solve(covariance, step) / len(step)
                )
    nees, white_nees = (float(np.mean(squares[key])) for key in (True, False))
    print(f"{n_seeds} seeds from 100, slow noise {slow_ratio}: NEES {nees:.2f}, white {white_nees:.2f}")
    assert 0.3 < nees < 1.5
    if not slow_ratio:
        assert nees > 0.7 and white_nees < 0.1
