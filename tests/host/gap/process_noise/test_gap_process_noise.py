"""Clocks that are known to some milliseconds: followed where that is declared, an effect where it is not."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gap_matrix import cases, recording
from gap_matrix.make_case import make
from gap_matrix.world import Motion
from gap_runs import changed_model, gap
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.process_noise import list_process_noise, shared_walk_covariance
from hubodo.gap.process_noise.weights import declared_wheel_walk
from hubodo.gap.state.state import stack_channels
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Recording, Table

SEED = 8
LATE = {"left": 0.003, "right": -0.002}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A larger wheel, and nodes whose stamps are late by LATE and wander by half a millisecond."""
    folder = tmp_path_factory.mktemp("clocks")
    hidden = make(
        folder / "case", SEED, ["wheel_radius"], factor=2.0, scope="left", duration=33.0, rate_hz=30.0
    )
    read = read_folder(folder / "case")
    nodes = {}
    for name, table in read.nodes.items():
        late = LATE[name] + 5e-4 * np.sin(2 * np.pi * table.t / 30.0)
        nodes[name] = Table({**table.columns, "t": table.t + late})
    write_folder(Recording(nodes, reference=read.reference), folder / "log")
    return folder, hidden[0]


def test_with_clocks_declared_loose_only_the_wheel_is_named(drive, tmp_path):
    folder, hidden = drive
    model = changed_model(
        folder / "case",
        tmp_path / "model.toml",
        ("yaw_rate_noise = 0.0002", "yaw_rate_noise = 0.0002\nclock_sigma = 0.005"),
    )
    made = gap(tmp_path / "out", model, folder / "log")
    assert made.code == 0, made.err
    assert made.names == [("wheel_radius", "left")]
    error = made.result["found"][0]["parameters"]["error"]
    assert abs(error["value"] - hidden.parameters["error"]) < 4.0 * error["sigma"]
    # What it wrote knows its clocks as well, and needs nothing more.
    again = gap(tmp_path / "again", tmp_path / "out" / "model.toml", folder / "log")
    assert (again.result["verdict"], again.names) == ("no_gap", []), json.dumps(again.result["remaining"])


def test_with_one_clock_for_all_the_delays_are_named(drive, tmp_path):
    folder, _ = drive
    made = gap(tmp_path / "out", folder / "case" / "model.toml", folder / "log")
    assert {("time_offset", "left"), ("time_offset", "right"), ("wheel_radius", "left")} <= set(made.names)


@pytest.mark.parametrize("by", [1e-4, -2e-3])
def test_the_column_of_a_late_clock_is_the_slope_of_the_readings_in_time(drive, by):
    """Against the model with every stamp moved, to first order."""
    folder, _ = drive
    problem = build_problem(read_folder(folder / "case"), read_model(folder / "case" / "model.toml"))
    node, state = problem.nodes[0], build_initial_state(problem)
    moved = stack_channels(state.predict(node, [BY_NAME["time_offset"](delay=by)]))
    plain = stack_channels(state.predict(node, []))
    column = state.delay_columns[node.name]
    second_order = np.abs(moved - plain - by * column).max(axis=1)
    assert (second_order < 0.02 * np.abs(moved - plain).max(axis=1) * max(1.0, abs(by) / 1e-4)).all()


def test_both_wheels_are_carried_on_by_the_same_noise_of_a_level_speed(tmp_path):
    """Steps of both angles: the integrated noise of the speed, and that of the yaw rate with either sign."""
    setup = cases.setup(31, duration=40.0)
    motion = setup.drive.motion
    level = Motion(0.0 * motion.speed + 3.0, 0.0 * motion.yaw_rate)
    recording.write(replace(setup, drive=replace(setup.drive, motion=level)), [], tmp_path, {})
    problem = build_problem(read_folder(tmp_path), read_model(tmp_path / "model.toml"))
    assert problem.speed_noise == setup.speed_noise
    walks = {node.name: declared_wheel_walk(problem, node) for node in problem.nodes}
    wanderings = list_process_noise(build_initial_state(problem), walks)
    own = np.diag([0.0 if it.walk.is_white else it.walk.intensity for it in wanderings])
    together = shared_walk_covariance(problem, wanderings)
    wheels = np.flatnonzero(together.any(axis=0))
    found = (own + together)[np.ix_(wheels, wheels)]
    # A level is the mean of its samples: after T seconds a wheel is off by T sigma / (radius sqrt(n)).
    count = 1.0 / cases.REFERENCE_STEP
    each = setup.speed_noise**2 / count / setup.radius**2
    # A tenth is each wheel's own: no two roll quite alike.
    np.testing.assert_allclose(found, each * np.array([[1.0, 0.9], [0.9, 1.0]]), rtol=0.05)
