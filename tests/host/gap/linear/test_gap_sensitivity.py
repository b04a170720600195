"""Where gyros measured the speed, every node answers every effect as the model evaluated anew does."""

import numpy as np
import pytest

from gap_runs import changed_model
from hubodo.effects import BY_NAME, EFFECTS
from hubodo.effects.empirical import empirical
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.linear.sensitivity import Direction, DirectionSensitivities
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.screen.candidates import list_directions
from hubodo.gap.state.state import stack_channels
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

STEP = 1e-6
"""Of a usual size, one way: what is bent shows as much of its bend."""
OTHER = 1e-3
"""Of the largest answer of a column: by that much two ways of differentiating may differ."""
IN_MEAN = [effect for effect in EFFECTS if effect.visible_in == "mean"]
UNNAMED = empirical("empirical:gz,ax ~ harmonics(theta)")


@pytest.fixture(scope="module")
def state(nothing, tmp_path_factory):
    """A model with an arm and a camber, driven by what its own gyros measured."""
    path = tmp_path_factory.mktemp("shared") / "model.toml"
    model = changed_model(nothing, path, ('speed = "reference.speed"', 'speed = "nodes"'))
    problem = build_problem(read_folder(nothing), read_model(model))
    terms = [ModelTerm(BY_NAME["lever_arm"](x=0.02, y=-0.01, z=0.01), ALL)]
    terms += [ModelTerm(BY_NAME["wheel_camber"](angle=0.1), ALL)]
    return track_wheel_phase(build_initial_state(problem).with_terms(terms))[0]


def evaluated(state, direction, node):
    """(6, N) the channels of a node at a state moved along a direction, all of it worked out anew."""
    moved = direction.shifted_effect(STEP)
    kept = [term for term in state.terms if term.effect.name != moved.name]
    at = [ModelTerm(moved, direction.node or VEHICLE)]
    # Of an effect that all nodes have, the others keep theirs.
    there = next((term.effect for term in state.terms if term.effect.name == moved.name), None)
    if there is not None and direction.node:
        others = [node.name for node in state.problem.nodes if node.name != direction.node]
        at += [ModelTerm(there, other) for other in others]
    return stack_channels(state.with_terms([*kept, *at]).predictions[node])


def columns(at, directions):
    """(P, 6, N) for each node: how it answers every direction, looked at in one go."""
    samples = {node.name: slice(0, len(node.t)) for node in at.problem.nodes}
    made, part = DirectionSensitivities(at, directions), at.select(samples)
    return {node.name: made.columns(node, part, samples) for node in part.problem.nodes}


def assert_columns_are_those_evaluated_anew(at, directions):
    found = columns(at, directions)
    for k, direction in enumerate(directions):
        for node in at.problem.nodes:
            expected = (
                evaluated(at, direction, node.name) - stack_channels(at.predictions[node.name])
            ) / STEP
            error = np.abs(found[node.name][k] - expected).max()
            assert error <= OTHER * np.abs(expected).max() + 1e-6, (direction, node.name)


@pytest.mark.parametrize("there", [*IN_MEAN, UNNAMED], ids=lambda effect: effect.name)
def test_columns_are_those_of_the_model_evaluated_anew_beside_each_effect(state, there):
    seed = there.initial_guesses()[0]
    size = seed.coordinates() + 0.5 * there.coordinate_scales()
    at = state.with_term(ModelTerm(seed.with_coordinates(size), VEHICLE if there.level == "vehicle" else ALL))
    directions = list_directions(at)[:: 1 if there.name == "lever_arm" else 7]
    own = at.effects["left"][there]
    node = "" if there.level == "vehicle" else "left"
    directions += [Direction(own, node, k) for k in range(len(own.coordinates()))][::5]
    assert_columns_are_those_evaluated_anew(at, directions)


def test_beside_a_limit_what_is_added_beyond_it_is_not_read(state):
    limit = 0.5 * float(np.abs(state.predictions["left"].gyro).max())
    at = state.with_term(ModelTerm(BY_NAME["gyro_saturation"](limit=limit), ALL))
    directions = [it for it in list_directions(at) if it.effect.name in ("gyro_bias", "gyro_scale_factor")]
    assert_columns_are_those_evaluated_anew(at, directions)


def test_what_one_gyro_measured_otherwise_is_felt_by_the_other_node(state):
    directions = [it for it in list_directions(state) if it.effect.name == "gyro_bias" and it.node == "left"]
    felt = columns(state, directions)
    assert np.abs(felt["right"][2]).max() > 1e-3


@pytest.mark.parametrize("there", ["gyro_lag", "tyre_growth", "lever_arm"])
def test_columns_of_a_part_are_a_part_of_the_columns(state, there):
    """Also where what a node reads hangs on how it moved before."""
    seed = BY_NAME[there].initial_guesses()[0]
    at = state.with_term(
        ModelTerm(seed.with_coordinates(seed.coordinates() + 0.5 * seed.coordinate_scales()), ALL)
    )
    directions = list_directions(at)
    whole, made = columns(at, directions), DirectionSensitivities(at, directions)
    samples = {
        node.name: slice(len(node.t) // 3, len(node.t) // 2 + k) for k, node in enumerate(at.problem.nodes)
    }
    part = at.select(samples)
    for node in part.problem.nodes:
        expected = whole[node.name][:, :, samples[node.name]]
        sizes = np.abs(expected).max(axis=(1, 2), keepdims=True) + 1e-6
        found = made.columns(node, part, samples)
        np.testing.assert_allclose(found / sizes, expected / sizes, atol=1e-4)
