"""A point of the search works out what follows from it once, and no other point gets it by mistake."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.residual import compute_gap, compute_gap_floor
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.state.state import stack_channels
from hubodo.gap.state.terms import ALL, ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.forward import NodeModel
from hubodo.model.model_file import read_model


@pytest.fixture
def point(nothing):
    problem = build_problem(read_folder(nothing), read_model(nothing / "model.toml"))
    state, _ = track_wheel_phase(build_initial_state(problem))
    return Evaluation(state, estimate_weights(state))


@pytest.fixture
def evaluations(monkeypatch):
    """A list that grows by one with each evaluation of the forward model."""
    seen, mean = [], NodeModel.mean_reading

    def counted(self, *arguments):
        seen.append(self)
        return mean(self, *arguments)

    monkeypatch.setattr(NodeModel, "mean_reading", counted)
    return seen


def test_each_node_is_evaluated_once_however_often_its_readings_are_asked_for(point, evaluations):
    state = replace(point.state)
    for _ in range(3):
        assert set(state.predictions) == {"left", "right"}
        assert all(np.isfinite(state.residual(node)).all() for node in state.problem.nodes)
    assert len(evaluations) == 2
    for _ in range(3):
        assert set(state.phase_columns) == {"left", "right"}
    assert len(evaluations) == 6


def test_residuals_and_all_that_is_measured_in_them_cost_one_evaluation_and_one_slope(point, evaluations):
    fresh = Evaluation(replace(point.state), point.weights)
    compute_gap(fresh.residuals), compute_gap_floor(fresh.residuals), fresh.mean_residuals
    assert len(evaluations) == 6


def test_another_model_has_readings_of_its_own(point):
    was = {name: stack_channels(reading) for name, reading in point.state.predictions.items()}
    biased = point.state.with_term(ModelTerm(BY_NAME["gyro_bias"](x=0.1), ALL))
    for name, reading in biased.predictions.items():
        more = stack_channels(reading) - was[name]
        np.testing.assert_allclose(more, np.array([[0.1], [0], [0], [0], [0], [0]]) + 0.0 * more, atol=1e-12)
        np.testing.assert_array_equal(stack_channels(point.state.predictions[name]), was[name])
    ahead = replace(
        point.state,
        phase_offsets={**point.state.phase_offsets, "left": point.state.phase_offsets["left"] + 1e-4},
    )
    turned = (stack_channels(ahead.predictions["left"]) - was["left"]) / 1e-4
    np.testing.assert_allclose(turned, point.state.phase_columns["left"], atol=2e-3)
    np.testing.assert_array_equal(stack_channels(ahead.predictions["right"]), was["right"])


def test_with_other_weights_the_readings_stay_and_the_residuals_do_not(point):
    walks = {name: 100.0 * walk for name, walk in point.weights.wheel_walks.items()}
    loose = replace(point, weights=replace(point.weights, wheel_walks=walks))
    assert loose.state.predictions is point.state.predictions
    # A wheel that may wander more takes more of the residual with it.
    assert compute_gap(loose.residuals) < compute_gap(point.residuals)
    assert point.without_cache().state.terms == point.state.terms
    assert compute_gap(point.without_cache().residuals) == compute_gap(point.residuals)


def test_a_residual_and_what_was_predicted_are_what_was_measured(point):
    for residual in point.residuals.values():
        np.testing.assert_allclose(residual.value + residual.predicted, residual.node.y, atol=1e-12)


def test_stale_samples_are_compared_in_the_gap_with_what_the_model_said_before_them(point):
    """So are coarse steps: they widen what is declared in the gap, and nowhere else."""
    late = np.arange(5, min(len(node.t) for node in point.problem.nodes), 10)
    noise = {}
    for name, one in point.weights.noise.items():
        noise[name] = replace(one, is_new=~np.isin(np.arange(len(one.is_new)), late))
    effects = (BY_NAME["sample_repeat"](probability=0.1), BY_NAME["gyro_quantization"](step=0.05))
    state = point.state.with_terms([ModelTerm(effect, ALL) for effect in effects])
    stale = Evaluation(state, replace(point.weights, noise=noise))
    for name, residual in stale.residuals.items():
        mean = stale.mean_residuals[name]
        np.testing.assert_allclose(residual.predicted[:, late], mean.predicted[:, late - 1], atol=1e-12)
        np.testing.assert_allclose(residual.predicted[:, late - 1], mean.predicted[:, late - 1], atol=1e-12)
        wider = residual.declared_sigma[:3] ** 2 - mean.declared_sigma[:3] ** 2
        np.testing.assert_allclose(wider, 0.05**2 / 12.0, rtol=1e-9)
        np.testing.assert_allclose(residual.declared_sigma[3:], mean.declared_sigma[3:], rtol=1e-12)
