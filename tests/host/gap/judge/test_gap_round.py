"""Memory use of a search: weights, hypotheses and Gram matrices are small compared with the log."""

import pickle

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge.comparison import share_between_scopes
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.round import judge_round
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.symmetric import SymmetricStack
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.state.noise import ChannelNoise
from hubodo.gap.state.terms import ALL, ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

MAX_WEIGHT_BYTES_PER_SAMPLE = 3.0  # one float takes 8 bytes


@pytest.fixture(scope="module")
def evaluation(camber_case):
    folder, _ = camber_case
    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    state, _ = track_wheel_phase(build_initial_state(problem))
    return Evaluation(state, estimate_weights(state))


def test_weights_take_fewer_bytes_than_one_float_per_sample(evaluation):
    samples = sum(len(node.t) for node in evaluation.problem.nodes)
    assert len(pickle.dumps(evaluation.weights)) < MAX_WEIGHT_BYTES_PER_SAMPLE * samples


def test_a_round_stores_phase_offsets_only_for_its_best_hypothesis(evaluation):
    _, *others = judge_round(evaluation).hypotheses
    refitted_states = [hypothesis.state for hypothesis in others if hypothesis.state is not None]
    assert len(refitted_states) > 2
    assert all(
        not state.phase_offsets and not state.starts and not state.stamp_delays for state in refitted_states
    )


def test_the_best_hypothesis_has_phase_offsets_of_both_wheels(evaluation):
    best = judge_round(evaluation, reject=set(BY_NAME) - {"wheel_camber"}).best
    assert set(best.state.phase_offsets) == {"left", "right"}


def test_the_forward_models_of_nodes_do_not_store_lagged_samples(evaluation):
    state = evaluation.state.with_term(ModelTerm(BY_NAME["gyro_lag"](time_constant=0.01), ALL))
    assert set(state.predictions) == set(state.phase_columns) == {"left", "right"}
    forward_models = pickle.dumps([node.forward for node in evaluation.problem.nodes])
    inputs = pickle.dumps([node.forward.inputs for node in evaluation.problem.nodes])
    # At most 12 floats per sample: time stamps and the motion of the body from the inputs.
    assert len(forward_models) - len(inputs) < 8 * 12 * sum(len(node.t) for node in evaluation.problem.nodes)


def test_samples_of_a_group_share_its_noise_level():
    levels, group = np.arange(12.0).reshape(6, 2), np.array([0, 1, 1, 0], np.uint8)
    noise = ChannelNoise(levels, group, np.ones(4, bool))
    expected = np.stack([levels[:, 0], levels[:, 1], levels[:, 1], levels[:, 0]], axis=1)
    np.testing.assert_array_equal(noise.sigma, expected)
    np.testing.assert_array_equal(noise.sigma_at(slice(1, 3)), expected[:, 1:3])
    np.testing.assert_array_equal(noise.channel_sigma(4), expected[4])
    excluded = np.array([False, True, False, False])
    np.testing.assert_array_equal(noise.exclude(excluded).sigma, np.where(excluded, np.inf, expected))


@pytest.mark.parametrize("count", [1, 64, 150])
def test_a_symmetric_stack_of_any_length_computes_like_full_matrices(count):
    rng = np.random.default_rng(count)
    full = rng.standard_normal((count, 7, 7))
    full += full.transpose(0, 2, 1)
    stack = SymmetricStack.allocate(count, 7)
    stack.store(0, full[:40])
    stack.store(40, full[40:])
    vector, columns = rng.standard_normal(7), [5, 1, 6]
    assert len(stack) == count
    assert stack.triangles.nbytes == count * 28 * 8
    np.testing.assert_array_equal(stack.unpack(), full)
    np.testing.assert_allclose(stack.sum(), full.sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(
        stack.multiply(vector), np.einsum("bij,j->bi", full, vector), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_array_equal(stack.select(columns).unpack(), full[:, columns][:, :, columns])


@pytest.mark.parametrize(
    ("name", "delays", "other_total", "shares"),
    [
        ("time_offset", (0.03,), 4000.0, (0.5, 0.5)),
        ("time_offset", (-0.03,), 4000.0, (0.75, 0.25)),
        ("time_offset", (-0.03,), 2000.0, (1.0, 0.0)),
        ("clock_skew", (), 4000.0, (1.0, 0.0)),
    ],
)
def test_scopes_within_the_level_of_the_noise_share_the_probability(
    evaluation, name, delays, other_total, shares
):
    """The level of 3,000 leaves a held-out gain of 1,350 in doubt; three of four clocks are late."""
    hypotheses = [
        Hypothesis(
            ModelTerm(BY_NAME[effect](*delay), node),
            total,
            1.0,
            probability,
            evaluation.state,
            held_out_gain=HeldOutGain(total, 1.0, 3000.0),
        )
        for effect, node, total, probability, delay in (
            ("time_offset", "left", 4300.0, 1.0, (0.03,)),
            (name, "right", other_total, 0.0, delays),
        )
    ]
    assert tuple(one.probability for one in share_between_scopes(hypotheses, 3.5)) == shares
