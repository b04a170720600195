"""Calibration of wheels on drives with known positions: what is seen is right, what is not seen is named."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.calibration.file import Calibration, read_calibration
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.calibrate import calibrate_wheels
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.track import run
from hubodo.log.csv_folder import write_folder
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from hubodo.verbs import calibrate
from wheel_runs import config, tables

ERRORS = replace(wheel_drives.Errors(), radius=0.02, track=0.03)
TRUTH_OF = {
    ("wheel_radius", "error"): "radius",
    ("lever_arm", "x"): "arm_x",
    ("lever_arm", "y"): "arm_y",
    ("node_misalignment", "x"): "tilt_x",
    ("node_misalignment", "y"): "tilt_y",
    ("gyro_scale_factor", "z"): "spin_scale",
    ("gyro_scale_factor", "x"): "yaw_scale",
}


def _drive(seed: int, length: float = 120.0, facing: dict[str, str] | None = None) -> wheel_drives.WheelDrive:
    rng = np.random.default_rng(seed)
    return wheel_drives.drive(wheel_drives.loop(rng, length, 6.0), rng, ERRORS, facing=facing)


def _positions(drive: wheel_drives.WheelDrive, seed: int, sigma: float) -> tuple[np.ndarray, ...]:
    """At 5 Hz, turned by a radian: a map does not know how the vehicle stands."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, drive.t[-1], 0.2)
    place = np.interp(t, drive.t, drive.x) + 1j * np.interp(t, drive.t, drive.y)
    place = place * np.exp(1j) + sigma * (rng.standard_normal(len(t)) + 1j * rng.standard_normal(len(t)))
    return t, place.real, place.imag, np.full(len(t), sigma)


@pytest.fixture(scope="module", params=[None, {"right": "right"}], ids=["all left", "right right"])
def drives(
    request: pytest.FixtureRequest,
) -> tuple[dict[str, str] | None, dict[int, wheel_drives.WheelDrive]]:
    """Where the nodes face, and two drives by their seeds."""
    return request.param, {seed: _drive(seed, facing=request.param) for seed in (70, 71)}


@pytest.mark.parametrize("sigma", [0.01, 1.0])
def test_what_is_seen_lies_within_four_sigma_of_the_truth(
    sigma: float, drives: tuple[dict[str, str] | None, dict[int, wheel_drives.WheelDrive]]
) -> None:
    facing, made = drives
    for seed, drive in made.items():
        found = calibrate_wheels(config(drive, facing=facing), tables(drive), *_positions(drive, seed, sigma))
        for name, node in drive.nodes.items():
            for (effect, parameter), truth in TRUTH_OF.items():
                quantity = found.nodes[name].get(effect, {}).get(parameter)
                if quantity is not None:
                    off = abs(quantity.value - node.truth[truth])
                    assert off < 4.0 * quantity.sigma, (seed, name, effect, parameter)
            assert "lever_arm" in found.nodes[name]
            if sigma < 0.1:
                assert found.nodes[name]["wheel_radius"]["error"].sigma < 0.001


def test_the_first_half_of_a_drive_makes_the_distance_of_all_of_it_better() -> None:
    drive = _drive(72)
    t, x, y, sigma = _positions(drive, 72, 0.01)
    half = t < 0.5 * t[-1]
    found = calibrate_wheels(config(drive), tables(drive), t[half], x[half], y[half], sigma[half])
    calibration = Calibration()
    for name in drive.nodes:
        calibration = calibration.with_node(name, found.effects(name))
    calibration = calibration.with_vehicle(found.vehicle_effects())
    vehicle = Vehicle(drive.radius, drive.track, {name: NodeMount(name, "left") for name in drive.nodes})  # type: ignore[arg-type]
    off = {}
    for label, known in (("nominal", None), ("calibrated", calibration)):
        track = run(wheel_config(vehicle, list(drive.nodes), known), tables(drive)).track
        off[label] = abs(float(np.sum(np.hypot(np.diff(track.x), np.diff(track.y)))) - drive.length)
    print(off)
    assert off["calibrated"] < 0.3 * off["nominal"]


def test_a_straight_drive_names_track_and_scale_as_unseen() -> None:
    rng = np.random.default_rng(73)
    drive = wheel_drives.drive(wheel_drives.legs([(6.0, 0.0, 0.0), (30.0, 1.2, 0.0)]), rng, ERRORS)
    found = calibrate_wheels(config(drive), tables(drive), *_positions(drive, 73, 0.01))
    named = " ".join(found.unseen)
    assert "left.gyro_scale_factor.x" in named
    assert "vehicle.track_width.error" in named
    assert "track_width" not in found.vehicle


def test_one_node_has_no_track_width() -> None:
    drive = _drive(74, 60.0)
    found = calibrate_wheels(config(drive, ("left",)), tables(drive), *_positions(drive, 74, 0.01))
    assert found.vehicle == {}
    assert any("one node does not show it" in line for line in found.unseen)


def test_too_few_positions_and_too_short_a_drive_are_refused() -> None:
    drive = _drive(75, 20.0)
    t, x, y, sigma = _positions(drive, 75, 0.01)
    with pytest.raises(CalibrationError, match="at least ten"):
        calibrate_wheels(config(drive), tables(drive), t[:5], x[:5], y[:5], sigma[:5])
    with pytest.raises(CalibrationError, match="m from the start"):
        calibrate_wheels(config(drive), tables(drive), t, 0.01 * x, 0.01 * y, sigma)


def test_the_verb_writes_a_calibration_file_that_reads_back(tmp_path: Path) -> None:
    drive = _drive(76, 60.0)
    t, x, y, _ = _positions(drive, 76, 0.01)
    write_folder(Recording(tables(drive), truth=Table({"t": t, "x": x, "y": y})), tmp_path / "log")
    vehicle = tmp_path / "v.toml"
    vehicle.write_text(
        f"[vehicle]\nwheel_radius = {drive.radius}\ntrack_width = {drive.track}\n"
        '[nodes.left]\nside = "left"\nfacing = "left"\n[nodes.right]\nside = "right"\nfacing = "left"\n'
    )
    output = tmp_path / "c.toml"
    parser = argparse.ArgumentParser()
    calibrate.add_arguments(parser)
    words = ["wheels", str(tmp_path / "log"), "--vehicle", str(vehicle), "-o", str(output)]
    printed = calibrate.run(parser.parse_args(words)).as_json()
    written = read_calibration(output)
    assert printed["positions"] == "truth"
    found = written.nodes["left"].effects["wheel_radius"]
    assert found.parameters["error"].value == printed["nodes"]["left"]["wheel_radius"]["error"]["value"]
    assert found.parameters["error"].value == pytest.approx(drive.nodes["left"].truth["radius"], abs=0.002)
    assert len(found.source_sha256) == 64
    assert "track_width" in written.vehicle
