"""Tracking of wheel phases."""

from dataclasses import replace

import numpy as np

from gap_runs import write_changed_model
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.state.terms import ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Table


def test_tracking_a_tracked_state_changes_it_by_less_than_a_millirad(evaluation):
    tracked_again, walks = track_wheel_phase(evaluation.state)
    for name, offset in evaluation.state.phase_offsets.items():
        np.testing.assert_allclose(tracked_again.phase_offsets[name], offset, atol=1e-3)
        assert walks[name] > 0.0


def test_the_speed_is_corrected_for_an_acceleration_sensitive_gyro_at_the_tracked_wheel_angle(
    clean_log, tmp_path
):
    """A scale error turns the measured wheel by many turns too far; the sensitivity needs its true angle."""
    model = write_changed_model(
        clean_log, tmp_path / "model.toml", ('speed = "reference.speed"', 'speed = "nodes"')
    )
    recording, x, scale = read_folder(clean_log), 0.02, 0.01
    table = recording.nodes["left"]
    changed = (1.0 + scale) * table["gz"] + x * table["ax"]
    nodes = {**recording.nodes, "left": Table({**table.columns, "gz": changed})}
    problem = build_problem(replace(recording, nodes=nodes), read_model(model))
    terms = [
        ModelTerm(BY_NAME["gyro_g_sensitivity"](x=x), "left"),
        ModelTerm(BY_NAME["gyro_scale_factor"](z=scale), "left"),
    ]
    state, _ = track_wheel_phase(build_initial_state(problem).with_terms(terms))
    node = next(node for node in problem.nodes if node.name == "left")
    sign = np.sign(np.median(table["gz"]) * state.predictions["left"].rolling.spin.mean())
    expected = sign * node.forward.wheel_radius * (table["gz"] - changed)
    error = state.speed_errors["left"].correction - np.interp(
        node.t, table.t - table.t[0] + node.t[0], expected
    )
    # Without the tracked angle the error is larger than what is to be corrected.
    size = x * node.forward.wheel_radius * np.std(table["ax"])
    assert np.sqrt(np.mean(error**2)) < 0.2 * size
