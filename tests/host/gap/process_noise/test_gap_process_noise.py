"""Clock errors of some milliseconds: process noise if the model declares them, otherwise an effect."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from gap_matrix import cases, recording
from gap_matrix.make_case import write_case
from gap_matrix.world import Motion
from gap_runs import run_gap, write_changed_model
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.process_noise import (
    compute_noise_columns,
    list_process_noise,
    noise_indices,
    shared_walk_covariance,
)
from hubodo.gap.process_noise.segments import window_grid
from hubodo.gap.process_noise.weights import Weights, declared_wheel_walk
from hubodo.gap.state.state import stack_channels
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.model.forward import NodeInitialState, NodeModel
from hubodo.model.model_file import read_model
from hubodo.recording import Recording, Table

SEED = 8
CLOCK_DELAYS = {"left": 0.003, "right": -0.002}  # s


@pytest.fixture(scope="module")
def late_clock_case(tmp_path_factory):
    """Write a case with a larger wheel, delays CLOCK_DELAYS of the stamps and a clock drift of 0.5 ms."""
    folder = tmp_path_factory.mktemp("clocks")
    hidden = write_case(
        folder / "case", SEED, ["wheel_radius"], factor=2.0, scope="left", duration=33.0, rate_hz=30.0
    )
    log = read_folder(folder / "case")
    nodes = {}
    for name, table in log.nodes.items():
        delay = CLOCK_DELAYS[name] + 5e-4 * np.sin(2 * np.pi * table.t / 30.0)
        nodes[name] = Table({**table.columns, "t": table.t + delay})
    write_folder(Recording(nodes, reference=log.reference), folder / "log")
    return folder, hidden[0]


def test_only_the_wheel_radius_is_found_if_the_model_declares_clock_noise(late_clock_case, tmp_path):
    folder, hidden = late_clock_case
    model = write_changed_model(
        folder / "case",
        tmp_path / "model.toml",
        ("yaw_rate_noise = 0.0002", "yaw_rate_noise = 0.0002\nclock_sigma = 0.005"),
    )
    run = run_gap(tmp_path / "out", model, folder / "log")
    assert run.code == 0, run.err
    assert run.names == [("wheel_radius", "left")]
    error = run.result["found"][0]["parameters"]["error"]
    assert abs(error["value"] - hidden.parameters["error"]) < 4.0 * error["sigma"]
    assert run.result["gap"]["after"] < 1.05 < run.result["gap"]["before"], run.result["gap"]
    assert read_model(tmp_path / "out" / "model.toml").inputs.clock_sigma == 0.005


@pytest.mark.repeat
def test_delays_are_found_if_the_model_declares_no_clock_noise(late_clock_case, tmp_path):
    folder, _ = late_clock_case
    run = run_gap(tmp_path / "out", folder / "case" / "model.toml", folder / "log")
    assert {("time_offset", "left"), ("time_offset", "right"), ("wheel_radius", "left")} <= set(run.names)


@pytest.mark.parametrize("delay", [1e-4, -2e-3])
def test_the_delay_column_is_the_time_derivative_of_the_readings(late_clock_case, delay):
    """The reference is the model with delayed stamps; the difference is of second order in the delay."""
    folder, _ = late_clock_case
    problem = build_problem(read_folder(folder / "case"), read_model(folder / "case" / "model.toml"))
    node, state = problem.nodes[0], build_initial_state(problem)
    delayed_readings = stack_channels(state.predict(node, [BY_NAME["time_offset"](delay=delay)]))
    readings_without_delay = stack_channels(state.predict(node, []))
    slope = state.delay_columns[node.name]
    error = np.abs(delayed_readings - readings_without_delay - delay * slope).max(axis=1)
    assert (
        error
        < 0.02 * np.abs(delayed_readings - readings_without_delay).max(axis=1) * max(1.0, abs(delay) / 1e-4)
    ).all()


def test_the_phase_steps_of_both_wheels_share_the_noise_of_the_speed_input(tmp_path):
    """Phase steps integrate the noise of speed and yaw rate; that of the yaw rate has opposite signs."""
    setup = cases.draw_setup(31, duration=40.0)
    motion = setup.drive.motion
    straight_motion = Motion(0.0 * motion.speed + 3.0, 0.0 * motion.yaw_rate)
    recording.write_case_files(
        replace(setup, drive=replace(setup.drive, motion=straight_motion)), [], tmp_path, {}
    )
    problem = build_problem(read_folder(tmp_path), read_model(tmp_path / "model.toml"))
    assert problem.speed_noise == setup.speed_noise
    walks = {node.name: declared_wheel_walk(problem, node) for node in problem.nodes}
    noise_states = list_process_noise(build_initial_state(problem), Weights({}, walks))
    own_covariance = np.diag([0.0 if it.walk.is_white else it.walk.intensity for it in noise_states])
    shared_covariance = shared_walk_covariance(problem, noise_states)
    wheels = np.flatnonzero(shared_covariance.any(axis=0))
    step_covariance = (own_covariance + shared_covariance)[np.ix_(wheels, wheels)]
    # White speed noise sigma at n samples per second: the phase variance grows by sigma² / (n radius²) per s.
    count = 1.0 / cases.REFERENCE_STEP
    variance_per_second = setup.speed_noise**2 / count / setup.radius**2
    # A tenth of the variance is independent: the two wheels do not roll identically.
    np.testing.assert_allclose(
        step_covariance, variance_per_second * np.array([[1.0, 0.9], [0.9, 1.0]]), rtol=0.05
    )


def test_the_column_of_a_yaw_rate_offset_is_the_change_of_the_readings(problem):
    """The reference is the model with another yaw rate; wheels turn by the integral of the offset."""
    offset = 1e-4
    changed = replace(problem, yaw_rate_offset_sigma=0.01)
    state = build_initial_state(changed)
    walks = {node.name: declared_wheel_walk(changed, node) for node in changed.nodes if node.on_wheel}
    noises = list_process_noise(state, Weights({}, walks))
    (index,) = [k for k, noise in enumerate(noises) if noise.source == "yaw rate offset"]
    assert noises[index].walk.start_variance == pytest.approx(0.01**2)
    grid = window_grid(changed)
    for node in changed.nodes:
        column = compute_noise_columns(state, node, noises, grid)[noise_indices(noises, node).index(index)]
        readings = [_predict_with_yaw_offset(node, sign * offset) for sign in (1.0, -1.0)]
        expected = (readings[0] - readings[1]) / (2.0 * offset)
        np.testing.assert_allclose(column, expected, atol=1e-3 * np.abs(expected).max())


def _predict_with_yaw_offset(node, offset):
    inputs = node.forward.inputs
    spline = inputs.yaw_rate.spline
    shifted = replace(inputs.yaw_rate, spline=BSpline(spline.t, spline.c + offset, spline.k))
    full = node.forward
    forward = NodeModel(
        replace(inputs, yaw_rate=shifted), node.t, node.mount, full.wheel_radius, full.track_width
    )
    return stack_channels(forward.mean_reading((), NodeInitialState()))
