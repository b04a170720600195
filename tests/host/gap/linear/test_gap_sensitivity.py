"""Sensitivity columns of every effect against finite differences, with the speed measured by the gyros."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gap_runs import write_changed_model
from hubodo.effects import BY_NAME, EFFECTS
from hubodo.effects.empirical import empirical_class
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.linear.sensitivity import Direction, DirectionSensitivities
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.screen.candidates import list_directions
from hubodo.gap.state.state import stack_channels
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

STEP_IN_TYPICAL_SIZES = 1e-6
"""Forward difference, in typical sizes of a parameter: small enough for curvature not to matter."""
MAX_RELATIVE_DIFFERENCE = 1e-3
"""Permitted difference between the derivatives, relative to the largest value of a column."""
EFFECTS_ON_MEAN = [effect for effect in EFFECTS if effect.visible_in == "mean"]
EMPIRICAL_TERM = empirical_class("empirical:gz,ax ~ harmonics(theta)")


@pytest.fixture(scope="module")
def state(clean_log, tmp_path_factory):
    """Return a state with a lever arm and camber whose speed input is measured by the gyros of its nodes."""
    path = tmp_path_factory.mktemp("shared") / "model.toml"
    model = write_changed_model(clean_log, path, ('speed = "reference.speed"', 'speed = "nodes"'))
    problem = build_problem(read_folder(clean_log), read_model(model))
    terms = [ModelTerm(BY_NAME["lever_arm"](x=0.02, y=-0.01, z=0.01), ALL)]
    terms += [ModelTerm(BY_NAME["wheel_camber"](angle=0.1), ALL)]
    return track_wheel_phase(build_initial_state(problem).with_terms(terms))[0]


@pytest.fixture(scope="module")
def misaligned_state(state):
    """Return a state with tilted nodes without a lever arm, whose gyros measure the speed."""
    tilt = BY_NAME["node_misalignment"](x=0.1, y=-0.06)
    return track_wheel_phase(state.reset_with_terms([ModelTerm(tilt, ALL)]))[0]


def predict_shifted(state, direction, node):
    """Return the predicted channels (6, N) of a node after one step along a direction."""
    shifted = direction.shifted_effect(STEP_IN_TYPICAL_SIZES)
    unchanged = [term for term in state.terms if term.effect.name != shifted.name]
    changed = [ModelTerm(shifted, direction.node or VEHICLE)]
    # If all nodes have the effect, the other nodes keep its present parameters.
    present = next((term.effect for term in state.terms if term.effect.name == shifted.name), None)
    if present is not None and direction.node:
        other_names = [node.name for node in state.problem.nodes if node.name != direction.node]
        changed += [ModelTerm(present, name) for name in other_names]
    return stack_channels(state.with_terms([*unchanged, *changed]).predictions[node])


def compute_columns(state, directions):
    """Return the sensitivity columns (P, 6, N) of each node to all P directions."""
    samples = {node.name: slice(0, len(node.t)) for node in state.problem.nodes}
    sensitivities, part = DirectionSensitivities(state, directions), state.select(samples)
    return {node.name: sensitivities.columns(node, part, samples) for node in part.problem.nodes}


def assert_columns_match_finite_differences(state, directions):
    columns_of_node = compute_columns(state, directions)
    for k, direction in enumerate(directions):
        for node in state.problem.nodes:
            before = stack_channels(state.predictions[node.name])
            expected = (predict_shifted(state, direction, node.name) - before) / STEP_IN_TYPICAL_SIZES
            error = np.abs(columns_of_node[node.name][k] - expected).max()
            assert error <= MAX_RELATIVE_DIFFERENCE * np.abs(expected).max() + 1e-6, (direction, node.name)


@pytest.mark.parametrize("effect", [*EFFECTS_ON_MEAN, EMPIRICAL_TERM], ids=lambda effect: effect.name)
def test_columns_match_finite_differences_in_the_presence_of_each_effect(state, effect):
    guess = effect.initial_guesses()[0]
    coordinates = guess.coordinates() + 0.5 * effect.coordinate_scales()
    scope, node = (VEHICLE, "") if effect.level == "vehicle" else (ALL, "left")
    state_with_effect = state.with_term(ModelTerm(guess.with_coordinates(coordinates), scope))
    # Every seventh direction, to save time; all of them for one effect.
    directions = list_directions(state_with_effect)[:: 1 if effect.name == "lever_arm" else 7]
    instance = state_with_effect.effects["left"][effect]
    directions += [Direction(instance, node, k) for k in range(len(instance.coordinates()))][::5]
    assert_columns_match_finite_differences(state_with_effect, directions)


def test_columns_match_finite_differences_when_the_gyro_saturates(state):
    limit = 0.5 * float(np.abs(state.predictions["left"].gyro).max())
    saturated = state.with_term(ModelTerm(BY_NAME["gyro_saturation"](limit=limit), ALL))
    names = ("gyro_bias", "gyro_scale_factor")
    directions = [it for it in list_directions(saturated) if it.effect.name in names]
    assert_columns_match_finite_differences(saturated, directions)


def test_a_gyro_bias_of_one_node_changes_predictions_of_the_other(state):
    directions = [it for it in list_directions(state) if it.effect.name == "gyro_bias" and it.node == "left"]
    assert np.abs(compute_columns(state, directions)["right"][2]).max() > 1e-3


@pytest.mark.parametrize("name", ["gyro_lag", "tyre_growth", "lever_arm"])
def test_columns_of_a_slice_are_a_slice_of_the_columns(state, name):
    """The slice of a lagged reading includes the effect of the motion before the slice."""
    guess = BY_NAME[name].initial_guesses()[0]
    effect = guess.with_coordinates(guess.coordinates() + 0.5 * guess.coordinate_scales())
    state_with_effect = state.with_term(ModelTerm(effect, ALL))
    directions = list_directions(state_with_effect)
    all_columns = compute_columns(state_with_effect, directions)
    sensitivities = DirectionSensitivities(state_with_effect, directions)
    samples = {
        node.name: slice(len(node.t) // 3, len(node.t) // 2 + k)
        for k, node in enumerate(state_with_effect.problem.nodes)
    }
    part = state_with_effect.select(samples)
    for node in part.problem.nodes:
        expected = all_columns[node.name][:, :, samples[node.name]]
        sizes = np.abs(expected).max(axis=(1, 2), keepdims=True) + 1e-6
        columns_of_part = sensitivities.columns(node, part, samples)
        np.testing.assert_allclose(columns_of_part / sizes, expected / sizes, atol=1e-4)


def test_a_delay_moves_no_sample_at_the_ends_of_the_log_more_than_others(state):
    """Inputs begin with the first node that measured the speed: no derivative steps out of them."""
    directions = [d for d in list_directions(state) if d.effect.name in ("time_offset", "clock_skew")]
    for columns in compute_columns(state, directions).values():
        for column in columns:
            inner = np.abs(column[:, 5:-5]).max(axis=1)
            assert (np.abs(column[:, [0, -1]]).max(axis=1) <= 10.0 * inner).all()


@pytest.mark.parametrize("name", ("left", "right"))
def test_a_rotation_of_a_node_about_its_axle_only_changes_the_wheel_angle(misaligned_state, name):
    """The speed that the gyros measured stays: Rz(a) R(x, y, 0) is R(x, y, 0) at another wheel angle."""
    tilt = misaligned_state.effects[name][BY_NAME["node_misalignment"]]
    rotated = (
        Rotation.from_rotvec([0.0, 0.0, 1e-6]) * Rotation.from_rotvec([tilt.x, tilt.y, 0.0])
    ).as_rotvec()
    slopes = (rotated - [tilt.x, tilt.y, 0.0]) / 1e-6 / tilt.coordinate_scales()
    columns = compute_columns(misaligned_state, [Direction(tilt, name, k) for k in range(3)])
    for node in misaligned_state.problem.nodes:
        column = np.tensordot(slopes, columns[node.name], 1)
        turned = misaligned_state.phase_columns[node.name] if node.name == name else np.zeros_like(column)
        sign = np.sign(np.vdot(column, turned)) if node.name == name else 1.0
        largest = np.abs(misaligned_state.phase_columns[node.name]).max(axis=1)
        assert np.abs(column - sign * turned).max(axis=1) == pytest.approx(0.0, abs=1e-4 * largest.max())
