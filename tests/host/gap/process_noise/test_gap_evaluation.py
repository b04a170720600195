"""Evaluation of a state: predictions and residuals are computed once and never shared with another state."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.residual import NO_STEPS, compute_gap, compute_gap_floor
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.state.state import stack_channels
from hubodo.gap.state.terms import ALL, ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.forward import NodeModel
from hubodo.model.model_file import read_model


@pytest.fixture
def evaluation(clean_log):
    problem = build_problem(read_folder(clean_log), read_model(clean_log / "model.toml"))
    state, _ = track_wheel_phase(build_initial_state(problem))
    return Evaluation(state, estimate_weights(state))


@pytest.fixture
def model_calls(monkeypatch):
    """Return a list that grows by one with each call of the forward model."""
    calls, mean_reading = [], NodeModel.mean_reading

    def record_call(self, *arguments):
        calls.append(self)
        return mean_reading(self, *arguments)

    monkeypatch.setattr(NodeModel, "mean_reading", record_call)
    return calls


def test_predictions_of_each_node_are_computed_once_and_cached(evaluation, model_calls):
    state = replace(evaluation.state)
    for _ in range(3):
        assert set(state.predictions) == {"left", "right"}
        assert all(np.isfinite(state.residual(node)).all() for node in state.problem.nodes)
    assert len(model_calls) == 2
    for _ in range(3):
        assert set(state.phase_columns) == {"left", "right"}
    assert len(model_calls) == 6


def test_residuals_gap_and_floor_share_one_evaluation_and_one_derivative(evaluation, model_calls):
    fresh = Evaluation(replace(evaluation.state), evaluation.weights)
    compute_gap(fresh.residuals), compute_gap_floor(fresh.residuals), fresh.mean_residuals
    assert len(model_calls) == 6


def test_a_walk_that_follows_a_wrong_radius_does_not_hide_it_in_the_gap(evaluation):
    """The angle of the wheel is tracked by gravity, with steps that are too large for its walk."""
    rms, gap_ratio = {}, {}
    for error in (0.0, 5e-3):
        terms = [ModelTerm(BY_NAME["wheel_radius"](error=error), "left")]
        state, _ = track_wheel_phase(evaluation.state.reset_with_terms(terms))
        residual = Evaluation(state, evaluation.weights).residuals["left"]
        rms[error] = float(np.sqrt(np.mean(residual.walk_steps.steps**2)))
        without_steps = {"left": replace(residual, walk_steps=NO_STEPS)}
        gap_ratio[error] = compute_gap({"left": residual}) / compute_gap(without_steps)
    print(f"rms of the steps, sigma: {rms}, gap with and without them: {gap_ratio}")
    assert rms[0.0] < 1.0 and rms[5e-3] > 10.0
    assert 0.98 < gap_ratio[0.0] <= 1.0 and gap_ratio[5e-3] > 1.3


def test_a_changed_state_does_not_reuse_cached_predictions(evaluation):
    readings_before = {
        name: stack_channels(reading) for name, reading in evaluation.state.predictions.items()
    }
    biased = evaluation.state.with_term(ModelTerm(BY_NAME["gyro_bias"](x=0.1), ALL))
    for name, reading in biased.predictions.items():
        change = stack_channels(reading) - readings_before[name]
        np.testing.assert_allclose(
            change, np.array([[0.1], [0], [0], [0], [0], [0]]) + 0.0 * change, atol=1e-12
        )
        np.testing.assert_array_equal(
            stack_channels(evaluation.state.predictions[name]), readings_before[name]
        )
    shifted = replace(
        evaluation.state,
        phase_offsets={
            **evaluation.state.phase_offsets,
            "left": evaluation.state.phase_offsets["left"] + 1e-4,
        },
    )
    slope = (stack_channels(shifted.predictions["left"]) - readings_before["left"]) / 1e-4
    np.testing.assert_allclose(slope, evaluation.state.phase_columns["left"], atol=2e-3)
    np.testing.assert_array_equal(stack_channels(shifted.predictions["right"]), readings_before["right"])


def test_changed_weights_keep_predictions_and_change_residuals(evaluation):
    walks = {name: 100.0 * walk for name, walk in evaluation.weights.wheel_walks.items()}
    with_wider_walks = replace(evaluation, weights=replace(evaluation.weights, wheel_walks=walks))
    assert with_wider_walks.state.predictions is evaluation.state.predictions
    # A wheel phase with a larger walk absorbs more of the residual.
    assert compute_gap(with_wider_walks.residuals) < compute_gap(evaluation.residuals)
    assert evaluation.without_cache().state.terms == evaluation.state.terms
    assert compute_gap(evaluation.without_cache().residuals) == compute_gap(evaluation.residuals)


def test_residual_plus_prediction_is_the_measurement(evaluation):
    for residual in evaluation.residuals.values():
        np.testing.assert_allclose(residual.value + residual.predicted, residual.node.y, atol=1e-12)


def test_repeated_samples_are_compared_with_the_prediction_of_the_sample_before(evaluation):
    """Quantization steps, too, widen the declared sigma in the gap only, not in the mean residuals."""
    stale_indices = np.arange(5, min(len(node.t) for node in evaluation.problem.nodes), 10)
    noise = {}
    for name, channel_noise in evaluation.weights.noise.items():
        indices = np.arange(len(channel_noise.is_new))
        noise[name] = replace(channel_noise, is_new=~np.isin(indices, stale_indices))
    effects = (BY_NAME["sample_repeat"](probability=0.1), BY_NAME["gyro_quantization"](step=0.05))
    state = evaluation.state.with_terms([ModelTerm(effect, ALL) for effect in effects])
    stale_evaluation = Evaluation(state, replace(evaluation.weights, noise=noise))
    for name, residual in stale_evaluation.residuals.items():
        mean_residual = stale_evaluation.mean_residuals[name]
        np.testing.assert_allclose(
            residual.predicted[:, stale_indices], mean_residual.predicted[:, stale_indices - 1], atol=1e-12
        )
        np.testing.assert_allclose(
            residual.predicted[:, stale_indices - 1],
            mean_residual.predicted[:, stale_indices - 1],
            atol=1e-12,
        )
        quantization_variance = residual.declared_sigma[:3] ** 2 - mean_residual.declared_sigma[:3] ** 2
        np.testing.assert_allclose(quantization_variance, 0.05**2 / 12.0, rtol=1e-9)
        np.testing.assert_allclose(residual.declared_sigma[3:], mean_residual.declared_sigma[3:], rtol=1e-12)
