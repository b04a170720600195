"""What a search of a long log keeps is small beside the log, and nothing is lost by that."""

import pickle

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge.round import judge_round
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.symmetric import SymmetricStack
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.state.noise import ChannelNoise
from hubodo.gap.state.terms import ALL, ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

KEPT = 3.0  # bytes per sample of a node, where one number takes 8


@pytest.fixture(scope="module")
def point(camber):
    folder, _ = camber
    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    state, _ = track_wheel_phase(build_initial_state(problem))
    return Evaluation(state, estimate_weights(state))


def test_weights_take_less_than_one_number_per_sample(point):
    samples = sum(len(node.t) for node in point.problem.nodes)
    assert len(pickle.dumps(point.weights)) < KEPT * samples


def test_a_round_keeps_the_paths_of_its_best_alone(point):
    _, *others = judge_round(point).hypotheses
    moved = [rival.state for rival in others if rival.state is not None]
    assert len(moved) > 2
    assert all(not state.phase_offsets and not state.starts and not state.stamp_delays for state in moved)


def test_the_best_of_a_round_says_where_its_wheels_went(point):
    best = judge_round(point, reject=set(BY_NAME) - {"wheel_camber"}).best
    assert set(best.state.phase_offsets) == {"left", "right"}


def test_what_a_lag_makes_of_all_samples_at_once_is_not_kept_in_the_nodes(point):
    state = point.state.with_term(ModelTerm(BY_NAME["gyro_lag"](time_constant=0.01), ALL))
    assert set(state.predictions) == set(state.phase_columns) == {"left", "right"}
    kept = pickle.dumps([node.forward for node in point.problem.nodes])
    inputs = pickle.dumps([node.forward.inputs for node in point.problem.nodes])
    # Stamps, and of the body all that the inputs say.
    assert len(kept) - len(inputs) < 8 * 12 * sum(len(node.t) for node in point.problem.nodes)


def test_the_noise_of_a_group_is_that_of_all_its_samples():
    levels, group = np.arange(12.0).reshape(6, 2), np.array([0, 1, 1, 0], np.uint8)
    noise = ChannelNoise(levels, group, np.ones(4, bool))
    found = np.stack([levels[:, 0], levels[:, 1], levels[:, 1], levels[:, 0]], axis=1)
    np.testing.assert_array_equal(noise.sigma, found)
    np.testing.assert_array_equal(noise.sigma_at(slice(1, 3)), found[:, 1:3])
    np.testing.assert_array_equal(noise.channel_sigma(4), found[4])
    out = np.array([False, True, False, False])
    np.testing.assert_array_equal(noise.exclude(out).sigma, np.where(out, np.inf, found))


@pytest.mark.parametrize("count", [1, 64, 150])
def test_halves_of_symmetric_matrices_say_what_the_whole_ones_do(count):
    rng = np.random.default_rng(count)
    whole = rng.standard_normal((count, 7, 7))
    whole += whole.transpose(0, 2, 1)
    made = SymmetricStack.allocate(count, 7)
    made.store(0, whole[:40])
    made.store(40, whole[40:])
    vector, kept = rng.standard_normal(7), [5, 1, 6]
    assert len(made) == count
    assert made.triangles.nbytes == count * 28 * 8
    np.testing.assert_array_equal(made.unpack(), whole)
    np.testing.assert_allclose(made.sum(), whole.sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(
        made.multiply(vector), np.einsum("bij,j->bi", whole, vector), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_array_equal(made.select(kept).unpack(), whole[:, kept][:, :, kept])
