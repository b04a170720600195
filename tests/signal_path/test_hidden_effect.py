"""Effects hidden below the registers of an emulated chip are identified in the recorded log."""

import json
import math

import numpy as np
import pytest

from gap_runs import run_gap
from hubodo.cli import main
from hubodo.log.recording_reader import read_recording
from hubodo.log.recording_writer import write_recording
from vehicles import model_toml
from virtual_runs import micropython_or_skip

G = 9.80665
CAMBER, LIMIT = 0.15, 9.5
# Slightly more than the minimum duration of the search for effects.
SECONDS, RATE, SEED = 21.0, 104, 2
RIGHT = model_toml(
    0.165,
    0.55,
    gyro_noise=0.002,
    accel_noise=0.02,
    inputs="speed_noise = 0.001\nclock_sigma = 0.005\n",
    facing={"right": "left"},
)
MODEL = f"""{RIGHT}
[nodes.left]
side = "left"
facing = "left"
[nodes.left.effects.wheel_camber]
angle = {CAMBER}
[nodes.left.effects.gyro_bias]
x = 0.03
[nodes.left.effects.outliers]
probability = 0.02
sigma = 60.0
[nodes.left.effects.accel_saturation]
limit = {LIMIT}
[nodes.right.effects.wheel_radius]
error = 0.05
"""


@pytest.fixture(scope="module")
def ride(tmp_path_factory):
    """Record a ride through chips, firmware and serial ports."""
    micropython_or_skip()
    folder = tmp_path_factory.mktemp("hidden")
    (folder / "model.toml").write_text(MODEL)
    words = ["simulate", str(folder / "model.toml"), "-o", str(folder / "drive.mcap"), "--virtual-node"]
    assert main([*words, "--duration", str(SECONDS), "--rate", str(RATE), "--seed", str(SEED)]) == 0
    return read_recording(folder / "drive.mcap")


def driving(ride, node):
    """Return the samples of a node during the drive."""
    table, truth = ride.nodes[node], ride.truth
    inside = (table.t > truth.t[0]) & (table.t < truth.t[-1])
    return table.t[inside], table.gyro[inside], table.accel[inside]


def resting(ride, node):
    """Return (gyro, accel) of a node before the drive."""
    table = ride.nodes[node]
    before = table.t < ride.truth.t[0]
    return table.gyro[before], table.accel[before]


def test_both_nodes_are_recorded_completely(ride):
    for node in ("left", "right"):
        t, _, _ = driving(ride, node)
        assert len(t) == pytest.approx(SECONDS * RATE, rel=0.02)
    assert json.loads(ride.metadata["simulated.seed"]) == SEED


def test_the_lean_of_one_wheel_is_in_its_log_and_not_in_the_other(ride):
    """Hand calculation: an axle tilted by the camber measures g sin(camber) along it."""
    for node, camber in (("left", CAMBER), ("right", 0.0)):
        _, accel = resting(ride, node)
        assert np.median(accel[:, 2]) == pytest.approx(G * math.sin(camber), abs=0.02)


def test_the_offset_of_a_gyro_is_in_the_log(ride):
    for node, bias in (("left", 0.03), ("right", 0.0)):
        gyro, _ = resting(ride, node)
        np.testing.assert_allclose(np.median(gyro, axis=0), [bias, 0.0, 0.0], atol=1e-3)


def test_wild_samples_are_in_the_log_of_the_node_that_has_them(ride):
    """Hand calculation: of 2 % with 1 sigma 1.2 m/s², 68 % exceed 0.5 m/s²; noise alone never does."""
    wild = {}
    for node in ("left", "right"):
        _, accel = resting(ride, node)
        wild[node] = np.mean(np.abs(accel - np.median(accel, axis=0)) > 0.5)
    assert wild["left"] == pytest.approx(0.02 * math.erfc(0.5 / 1.2 / math.sqrt(2)), rel=0.5)
    assert wild["right"] == 0.0


def test_nothing_beyond_the_limit_of_one_accelerometer_is_in_its_log(ride):
    highest = {node: np.abs(driving(ride, node)[2]).max() for node in ("left", "right")}
    assert LIMIT - 0.01 <= highest["left"] <= LIMIT + 0.01
    assert highest["right"] > LIMIT + 0.1


def test_a_wheel_that_is_larger_turns_less(ride):
    """The distance of the right wheel by its gyro is 5 % short of the true distance."""
    t, gyro, _ = driving(ride, "right")
    truth = ride.truth
    heading, speed = (
        truth["heading"],
        np.hypot(np.gradient(truth["x"], truth.t), np.gradient(truth["y"], truth.t)),
    )
    path = np.trapezoid(speed + np.gradient(heading, truth.t) * 0.275, truth.t)
    assert np.trapezoid(gyro[:, 2], t) * 0.165 == pytest.approx(path / 1.05, rel=0.01)


def test_the_reference_runs_on_the_clock_of_the_nodes(ride):
    """Speed and spin are correlated; delays of a busy computer count as link delay."""
    t, gyro, _ = driving(ride, "right")
    reference = ride.reference
    v = reference["speed"] + 0.275 * reference["yaw_rate"]
    at = np.arange(reference.t[0] + 0.5, reference.t[-1] - 0.5, 0.005)
    shifts = np.linspace(-0.1, 0.1, 41)
    spin = np.interp(at, t, gyro[:, 2]) * 0.165 * 1.05
    misfit = [np.std(spin - np.interp(at + shift, reference.t, v)) for shift in shifts]
    assert abs(shifts[int(np.argmin(misfit))]) < 0.03


def test_the_search_names_the_larger_wheel_and_nothing_else(ride, tmp_path):
    """Uses a model of the right node only: the log is too short for the effects of the left one."""
    write_recording(ride, tmp_path / "drive.mcap")
    (tmp_path / "model.toml").write_text(RIGHT)
    result = run_gap(tmp_path / "out", tmp_path / "model.toml", tmp_path / "drive.mcap")
    assert result.names == [("wheel_radius", "right")]
    error = result.result["found"][0]["parameters"]["error"]
    assert abs(error["value"] - 0.05) < 4.0 * error["sigma"]
