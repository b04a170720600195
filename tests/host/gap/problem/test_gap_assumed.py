"""`hubodo gap LOG --vehicle V.toml`: without a model file, noise and inputs are estimated from the log."""

import io
import json
import re
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest

from gap_matrix.make_case import write_case
from gap_runs import Run
from hubodo.cli import main
from hubodo.gap.problem.assumed import assume_model
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Recording, Table
from hubodo.vehicle import load_vehicle
from vehicles import vehicle_toml


def write_vehicle_file(case, path):
    """Write a vehicle file with only the [vehicle] and [nodes.*] tables of a case's model file."""
    text = (case / "model.toml").read_text("utf-8")
    text = re.sub(r"\[(imu|inputs)\][^\[]*", "", text)
    path.write_text(text, "utf-8")
    return path


def run_without_model(folder, log, vehicle, *options):
    """Run `hubodo gap` with a vehicle file in place of a model file."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(["gap", str(log), "--vehicle", str(vehicle), "-o", str(folder), *options])
    return Run(code, out.getvalue(), err.getvalue(), folder)


@pytest.fixture(scope="module")
def run_from_vehicle(camber_case, tmp_path_factory):
    """Return the run on the case with camber, given only the vehicle file."""
    folder = tmp_path_factory.mktemp("of_vehicle")
    return run_without_model(
        folder / "out", camber_case[0], write_vehicle_file(camber_case[0], folder / "v.toml")
    )


def test_camber_is_found_without_a_model_file(camber_case, run_from_vehicle):
    hidden, run = camber_case[1], run_from_vehicle
    assert run.code == 0, run.err
    assert run.names == [("wheel_camber", "right")]
    angle = run.result["found"][0]["parameters"]["angle"]
    assert abs(angle["value"] - hidden.parameters["angle"]) < 3.0 * angle["sigma"]
    assert not run.result["warnings"]


def test_the_written_model_has_the_effect_and_the_true_noise(camber_case, run_from_vehicle):
    case, _ = camber_case
    written, declared = read_model(run_from_vehicle.folder / "model.toml"), read_model(case / "model.toml")
    # 10 %: the noise is estimated from the quiet intervals of 40 s and includes some road vibration.
    assert written.noise.gyro == pytest.approx(declared.noise.gyro, rel=0.1)
    assert written.noise.accel == pytest.approx(declared.noise.accel, rel=0.1)
    assert written.inputs.speed_noise == pytest.approx(declared.inputs.speed_noise, rel=0.1)
    assert [item.effect.name for item in written.effects] == ["wheel_camber"]


def test_two_wheels_without_a_reference_suffice(tmp_path):
    write_case(tmp_path / "case", 5, ["lever_arm"], "strong", scope="left", duration=33.0, rate_hz=30.0)
    log = read_folder(tmp_path / "case")
    write_folder(Recording(log.nodes), tmp_path / "wheels")
    run = run_without_model(
        tmp_path / "out", tmp_path / "wheels", write_vehicle_file(tmp_path / "case", tmp_path / "v.toml")
    )
    assert run.names == [("lever_arm", "left")]
    assert "from the gyro axes across the axles" in run.out
    hidden = json.loads((tmp_path / "case" / "hidden.json").read_text("utf-8"))["hidden"][0]["parameters"]
    for name, value in run.result["found"][0]["parameters"].items():
        assert abs(value["value"] - hidden[name]) < 3.0 * value["sigma"], name


def test_an_upright_body_node_provides_the_yaw_rate(clean_log, tmp_path):
    log = read_folder(clean_log)
    t = log.reference.t
    rng = np.random.default_rng(1)
    horizontal = {name: 0.05 * rng.standard_normal(len(t)) for name in ("gx", "gy", "ax", "ay")}
    vertical = 9.80665 + 0.05 * rng.standard_normal(len(t))
    frame = Table({"t": t, **horizontal, "gz": log.reference["yaw_rate"], "az": vertical})
    vehicle = write_vehicle_file(clean_log, tmp_path / "v.toml")
    with vehicle.open("a", encoding="utf-8") as file:
        file.write("\n[nodes.frame]\n")
    recording = Recording({**log.nodes, "frame": frame})
    assert assume_model(recording, load_vehicle(vehicle)).inputs.yaw_rate == "nodes.frame.gz"
    lying = Table({**frame.columns, "ay": frame["az"], "az": frame["ay"]})
    recording = Recording({**log.nodes, "frame": lying})
    assert assume_model(recording, load_vehicle(vehicle)).inputs.yaw_rate == "nodes"


def test_a_log_without_a_speed_source_is_refused(clean_log, tmp_path):
    log = read_folder(clean_log)
    write_folder(Recording({"frame": log.nodes["left"]}), tmp_path / "log")
    (tmp_path / "v.toml").write_text(vehicle_toml(facing={}, frame=True))
    run = run_without_model(tmp_path / "out", tmp_path / "log", tmp_path / "v.toml")
    assert run.code == 2
    assert "nothing tells the speed" in run.err
    assert not run.folder.exists()


def test_a_model_and_a_vehicle_file_together_are_refused(clean_log, tmp_path):
    vehicle = write_vehicle_file(clean_log, tmp_path / "v.toml")
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        options = [str(clean_log / "model.toml"), str(clean_log), "--vehicle", str(vehicle)]
        code = main(["gap", *options, "-o", str(tmp_path / "out")])
    assert code == 2
    assert "both describe the vehicle" in err.getvalue()


def test_a_model_without_a_log_is_refused(clean_log, tmp_path):
    err = io.StringIO()
    with redirect_stderr(err):
        assert main(["gap", str(clean_log / "model.toml"), "-o", str(tmp_path / "out")]) == 2
    assert "LOG" in err.getvalue()
