"""`hubodo gap LOG --vehicle V.toml`: without a model file noise and inputs are as the log shows them."""

import io
import json
import re
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest

from gap_matrix.make_case import make
from gap_runs import Run
from hubodo.cli import main
from hubodo.gap.problem.assumed import assume_model
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Recording, Table
from hubodo.vehicle import load_vehicle
from vehicles import vehicle_toml


def vehicle_file(case, path):
    """[vehicle] and [nodes.*] of a case's model file, and nothing else of it."""
    text = (case / "model.toml").read_text("utf-8")
    text = re.sub(r"\[(imu|inputs)\][^\[]*", "", text)
    path.write_text(text, "utf-8")
    return path


def without_model(folder, log, vehicle, *words):
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(["gap", str(log), "--vehicle", str(vehicle), "-o", str(folder), *words])
    return Run(code, out.getvalue(), err.getvalue(), folder)


@pytest.fixture(scope="module")
def of_vehicle(camber, tmp_path_factory):
    """The run on the wheel that leans, of which only the vehicle is known."""
    folder = tmp_path_factory.mktemp("of_vehicle")
    return without_model(folder / "out", camber[0], vehicle_file(camber[0], folder / "v.toml"))


def test_what_a_model_file_would_have_shown_is_found_without_one(camber, of_vehicle):
    hidden, made = camber[1], of_vehicle
    assert made.code == 0, made.err
    assert made.names == [("wheel_camber", "right")]
    angle = made.result["found"][0]["parameters"]["angle"]
    assert abs(angle["value"] - hidden.parameters["angle"]) < 3.0 * angle["sigma"]
    assert not made.result["warnings"]


def test_the_model_it_writes_is_one_to_go_on_with(camber, of_vehicle):
    case, _ = camber
    written, declared = read_model(of_vehicle.folder / "model.toml"), read_model(case / "model.toml")
    # A tenth: the noise of half a minute of quiet stretches, and what the road adds to it.
    assert written.noise.gyro == pytest.approx(declared.noise.gyro, rel=0.1)
    assert written.noise.accel == pytest.approx(declared.noise.accel, rel=0.1)
    assert written.inputs.speed_noise == pytest.approx(declared.inputs.speed_noise, rel=0.1)
    assert [item.effect.name for item in written.effects] == ["wheel_camber"]


def test_two_wheels_without_any_reference_are_enough(tmp_path):
    make(tmp_path / "case", 5, ["lever_arm"], "strong", scope="left", duration=40.0, rate_hz=50.0)
    read = read_folder(tmp_path / "case")
    write_folder(Recording(read.nodes), tmp_path / "wheels")
    made = without_model(
        tmp_path / "out", tmp_path / "wheels", vehicle_file(tmp_path / "case", tmp_path / "v.toml")
    )
    assert made.names == [("lever_arm", "left")]
    assert "from the gyro axes across the axles" in made.out
    hidden = json.loads((tmp_path / "case" / "hidden.json").read_text("utf-8"))["hidden"][0]["parameters"]
    for name, value in made.result["found"][0]["parameters"].items():
        assert abs(value["value"] - hidden[name]) < 3.0 * value["sigma"], name


def test_an_upright_node_on_the_body_tells_the_yaw_rate(nothing, tmp_path):
    read = read_folder(nothing)
    t = read.reference.t
    rng = np.random.default_rng(1)
    flat = {name: 0.05 * rng.standard_normal(len(t)) for name in ("gx", "gy", "ax", "ay")}
    up = 9.80665 + 0.05 * rng.standard_normal(len(t))
    frame = Table({"t": t, **flat, "gz": read.reference["yaw_rate"], "az": up})
    vehicle = vehicle_file(nothing, tmp_path / "v.toml")
    with vehicle.open("a", encoding="utf-8") as file:
        file.write("\n[nodes.frame]\n")
    recording = Recording({**read.nodes, "frame": frame})
    assert assume_model(recording, load_vehicle(vehicle)).inputs.yaw_rate == "nodes.frame.gz"
    lying = Table({**frame.columns, "ay": frame["az"], "az": frame["ay"]})
    recording = Recording({**read.nodes, "frame": lying})
    assert assume_model(recording, load_vehicle(vehicle)).inputs.yaw_rate == "nodes"


def test_a_log_that_says_no_speed_is_refused(nothing, tmp_path):
    read = read_folder(nothing)
    write_folder(Recording({"frame": read.nodes["left"]}), tmp_path / "log")
    (tmp_path / "v.toml").write_text(vehicle_toml(facing={}, frame=True))
    made = without_model(tmp_path / "out", tmp_path / "log", tmp_path / "v.toml")
    assert made.code == 2
    assert "nothing tells the speed" in made.err
    assert not made.folder.exists()


def test_a_model_and_a_vehicle_are_one_too_many(nothing, tmp_path):
    vehicle = vehicle_file(nothing, tmp_path / "v.toml")
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        words = [str(nothing / "model.toml"), str(nothing), "--vehicle", str(vehicle)]
        code = main(["gap", *words, "-o", str(tmp_path / "out")])
    assert code == 2
    assert "both describe the vehicle" in err.getvalue()


def test_a_model_alone_still_wants_its_log(nothing, tmp_path):
    err = io.StringIO()
    with redirect_stderr(err):
        assert main(["gap", str(nothing / "model.toml"), "-o", str(tmp_path / "out")]) == 2
    assert "LOG" in err.getvalue()
