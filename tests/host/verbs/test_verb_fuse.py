"""`hubodo fuse` on recordings with a path in closed form."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from generators.gnss_drives import geodetic
from hubodo.cli import main
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from in_process import hubodo
from repetitions import first_and_more
from vehicles import DRIVE_MODEL, vehicle_toml

VEHICLE = vehicle_toml(0.25, 0.8, facing={"left": "left", "right": "right"})
G = 9.80665


def circle(standstill: float = 6.0, drive: float = 14.0) -> Recording:
    """Return a standstill followed by a circle of 2 m radius, in closed form; the right node faces right.

    The speed is a raised cosine with mean 1 m/s, so distance, heading and position have closed forms.
    """
    rate = 200.0
    t = np.arange(0.0, standstill + drive, 1 / rate)
    driving_time = np.clip(t - standstill, 0.0, drive)
    w = 2 * np.pi / drive
    v = np.where(t >= standstill, 1.0 - np.cos(w * driving_time), 0.0)
    dv = np.where(t >= standstill, w * np.sin(w * driving_time), 0.0)
    distance = driving_time - np.sin(w * driving_time) / w
    yaw, dyaw = v / 2.0, dv / 2.0
    nodes = {}
    for name, y, sign in (("left", 0.4, 1.0), ("right", -0.4, -1.0)):
        angle = (1.0 - y / 2.0) * distance / 0.25
        forward, sideways = dv - dyaw * y, yaw * (v - yaw * y)
        nodes[name] = Table(
            {
                "t": t,
                "gx": yaw * np.cos(angle),
                "gy": -sign * yaw * np.sin(angle),
                "gz": sign * (v - yaw * y) / 0.25 + 0.013,
                "ax": G * np.cos(angle) + forward * np.sin(angle),
                "ay": sign * (forward * np.cos(angle) - G * np.sin(angle)),
                "az": sign * sideways,
            }
        )
    heading = 0.3 + distance / 2.0
    truth = Table(
        {
            "t": t,
            "x": 7.0 + 2.0 * (np.sin(heading) - np.sin(0.3)),
            "y": -3.0 - 2.0 * (np.cos(heading) - np.cos(0.3)),
            "heading": heading,
        }
    )
    return Recording(nodes, truth=truth)


@pytest.fixture
def folder(tmp_path):
    write_recording(circle(), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    return tmp_path


def run_fuse(folder, *arguments):
    log, vehicle = str(folder / "log.mcap"), str(folder / "vehicle.toml")
    return main(["fuse", log, "--vehicle", vehicle, "-o", str(folder / "out"), *arguments])


@pytest.mark.parametrize(
    "arguments",
    [(), ("--smooth",), ("--smooth", "2"), ("--method", "differential"), ("--nodes", "right")],
)
def test_the_circle_is_estimated_and_compared_with_the_truth(folder, capsys, arguments):
    assert run_fuse(folder, "--json", *arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads((folder / "out" / "fuse.json").read_text())
    assert result["distance"] == pytest.approx(14.0, rel=5e-3)
    assert result["truth"]["final_error"] < 0.1
    assert result["truth"]["heading_rms"] < 0.02
    if not arguments:
        for side in ("left", "right"):
            bias = result["nodes"][side]["gyro_bias"]["z"]
            assert bias["value"] == pytest.approx(0.013, abs=max(1e-3, 3 * bias["sigma"]))


def test_an_output_that_is_named_like_a_file_is_refused(folder):
    done = hubodo(
        "fuse", folder / "log.mcap", "--vehicle", folder / "vehicle.toml", "-o", folder / "track.gpx"
    )
    assert done.code == 2 and "is the name of a file, and a folder is due here, such as track/" in done.err
    assert not (folder / "track.gpx").exists()


@pytest.mark.parametrize(
    ("arguments", "smoothing", "causal"),
    [
        ((), {"kind": "none"}, True),
        (("--smooth", "0"), {"kind": "none"}, True),
        (("--smooth",), {"kind": "full"}, False),
        (("--smooth", "full"), {"kind": "full"}, False),
        (("--smooth", "1.5"), {"kind": "fixed lag", "lag": 1.5}, False),
    ],
)
def test_fuse_json_names_the_smoothing_and_whether_it_is_causal(folder, capsys, arguments, smoothing, causal):
    assert run_fuse(folder, "--json", *arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["smoothing"] == smoothing
    assert result["causal"] is causal
    assert ("not causal" in result["methods"][0]) is not causal


@pytest.mark.parametrize("word", ["-1", "nan", "soon"])
def test_an_invalid_smoothing_lag_is_refused_in_one_line(folder, capsys, word):
    assert run_fuse(folder, "--smooth=" + word) == 2
    complaint = capsys.readouterr().err
    assert "--smooth" in complaint
    assert complaint.count("\n") == 1


@pytest.mark.parametrize("node", first_and_more("left", "right"))
@pytest.mark.parametrize("arguments", [(), ("--smooth", "1"), ("--smooth",)])
def test_one_node_gives_neither_track_width_nor_clock_offset(folder, capsys, node, arguments):
    assert run_fuse(folder, "--json", "--nodes", node, *arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["vehicle"] == {}
    assert list(result["nodes"]) == [node]
    # Positions alone show a radius; this file states no `radius_from`, so it is nominal.
    radius = result["nodes"][node]["wheel_radius"]["error"]
    assert radius["sigma"] == pytest.approx(math.hypot(0.025, 0.004), rel=0.01)


def test_the_track_begins_at_the_origin_with_the_heading_of_the_truth(folder):
    assert run_fuse(folder) == 0
    lines = (folder / "out" / "track.csv").read_text().splitlines()
    assert lines[0] == "t,x,y,heading,speed,sigma_x,sigma_y,sigma_heading,cov_xy,cov_x_heading,cov_y_heading"
    first = [float(cell) for cell in lines[1].split(",")]
    assert first[1:3] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert first[3] == pytest.approx(0.3)


def test_a_log_without_truth_has_no_error(tmp_path, capsys):
    recording = circle()
    write_recording(Recording(recording.nodes), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    assert run_fuse(tmp_path, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert "truth" not in result
    # `error` alone is a parameter of wheel_radius and track_width.
    assert not any(word in json.dumps(result) for word in ("_error", "percent", "heading_rms"))


def test_results_are_not_overwritten_without_force(folder, capsys):
    assert run_fuse(folder) == 0
    assert run_fuse(folder) == 2
    assert "exists" in capsys.readouterr().err
    assert run_fuse(folder, "--force") == 0


def test_a_missing_wheel_is_reported_and_the_other_one_is_used(tmp_path, capsys):
    write_recording(Recording({"left": circle().nodes["left"]}), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    assert run_fuse(tmp_path, "--json") == 0
    assert any("right: not in the log" in line for line in json.loads(capsys.readouterr().out)["warnings"])
    assert run_fuse(tmp_path, "--force", "--method", "differential") == 2
    assert "needs a node on each wheel" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [("--nodes", "front"), ()], ids=["asked for", "in the vehicle file"])
def test_an_unknown_node_is_refused_in_one_line_and_nothing_is_written(tmp_path, capsys, arguments):
    write_recording(Recording({"hub": circle().nodes["left"]}), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    assert run_fuse(tmp_path, *arguments) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    assert "front" in complaint or "there: hub" in complaint
    assert not (tmp_path / "out").exists()


def with_gnss(recording: Recording, sigma: float = 1.5) -> Recording:
    """Return the circle with GNSS fixes at 5 Hz of `sigma` m (1 sigma), seed 5."""
    rng = np.random.default_rng(5)
    truth = recording.truth
    t = np.arange(truth.t[0], truth.t[-1], 0.2)
    x, y = (np.interp(t, truth.t, truth[c]) + rng.normal(0, sigma, len(t)) for c in ("x", "y"))
    latitude, longitude = geodetic(x, y, 47.0, 8.0)
    gnss = {"t": t, "latitude_deg": latitude, "longitude_deg": longitude, "altitude": 400 + 0 * t}
    return replace(recording, gnss=Table({**gnss, "sigma": np.full(len(t), sigma)}))


def test_fixes_make_the_track_absolute_through_the_graph(tmp_path, capsys):
    write_recording(with_gnss(circle()), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    assert run_fuse(tmp_path, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert len(result["methods"]) == 2
    assert "factor graph with" in result["methods"][1]
    assert result["causal"] is False
    assert result["truth"]["rms_error"] < 0.5
    # Constants of the odometry that these few fixes do not observe are not reported.
    assert "turn" not in result["graph"]["constants"]
    assert run_fuse(tmp_path, "--json", "--force", "--no-graph") == 0
    assert len(json.loads(capsys.readouterr().out)["methods"]) == 1


def test_wheel_speeds_of_another_sensor_replace_nodes(tmp_path, capsys):
    recording = circle()
    w = 2 * np.pi / 14.0
    t = recording.truth.t
    v = np.where(t >= 6.0, 1.0 - np.cos(w * np.clip(t - 6.0, 0, 14)), 0.0)
    wheels = Table({"t": t, "left": v * (1 - 0.4 / 2), "right": v * (1 + 0.4 / 2)})
    body = recording.nodes["left"]
    write_recording(Recording({"frame": body}, wheels=wheels, truth=recording.truth), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    assert run_fuse(tmp_path, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["methods"] == ["differential odometry on wheel speeds"]
    assert result["truth"]["final_error"] < 0.01


@pytest.mark.parametrize("latitude", [91.0, 400.0])
def test_impossible_fixes_are_refused_in_one_line(tmp_path, capsys, latitude):
    recording = with_gnss(circle())
    columns = {**recording.gnss.columns, "latitude_deg": np.full(len(recording.gnss), latitude)}
    write_recording(replace(recording, gnss=Table(columns)), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    assert run_fuse(tmp_path) == 2
    assert "not on Earth" in capsys.readouterr().err


def test_a_calibration_is_applied_and_named(tmp_path, capsys):
    """A known bias is removed before the filter starts, and fuse.json names the calibration."""
    recording = circle()
    write_recording(replace(recording, metadata={"serial.left": "aa01"}), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    calibration = tmp_path / "calibration.toml"
    calibration.write_text(
        '[nodes.left]\nserial = "aa01"\n[nodes.left.effects.gyro_bias]\nmethod = "by hand"\n'
        f'source_sha256 = "{"0" * 64}"\ndate = "2026-01-01"\nz = {{ value = 0.013, sigma = 1e-5 }}\n'
    )
    assert run_fuse(tmp_path, "--json", "--calibration", str(calibration)) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["calibration"]["file"] == str(calibration)
    assert result["calibrated"]["left"]["applied"] == ["gyro_bias"]
    assert abs(result["nodes"]["left"]["gyro_bias"]["z"]["value"]) < 1e-3
    assert result["nodes"]["right"]["gyro_bias"]["z"]["value"] == pytest.approx(0.013, abs=1e-3)

    calibration.write_text(calibration.read_text().replace("aa01", "bb02"))
    assert run_fuse(tmp_path, "--force", "--calibration", str(calibration)) == 2
    assert "bb02" in capsys.readouterr().err


def test_without_a_vehicle_file_the_vehicle_of_the_log_is_used(tmp_path):
    (tmp_path / "model.toml").write_text(DRIVE_MODEL)
    log = tmp_path / "drive.mcap"
    assert hubodo("simulate", tmp_path / "model.toml", "--duration", "8", "-o", log).code == 0
    for words in ((), ("--vehicle", tmp_path / "model.toml")):
        done = hubodo("fuse", log, *words, "-o", tmp_path / f"out{len(words)}")
        assert done.code == 0, done.err
    assert (tmp_path / "out0/track.csv").read_text() == (tmp_path / "out2/track.csv").read_text()
    assert hubodo("export", log, "-o", tmp_path / "csv").code == 0
    done = hubodo("fuse", tmp_path / "csv", "-o", tmp_path / "out3")
    assert (done.code, "carries no vehicle; give --vehicle" in done.err) == (2, True)
    (tmp_path / "csv/vehicle.toml").write_text(DRIVE_MODEL)
    assert hubodo("fuse", tmp_path / "csv", "-o", tmp_path / "out3").code == 0


def test_a_node_misspelt_in_the_vehicle_file_is_named_with_the_one_of_the_log(tmp_path):
    (tmp_path / "model.toml").write_text(DRIVE_MODEL)
    log = tmp_path / "drive.mcap"
    assert hubodo("simulate", tmp_path / "model.toml", "--duration", "5", "-o", log).code == 0
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(DRIVE_MODEL.replace("nodes.right", "nodes.rigth"))
    done = hubodo("fuse", log, "--vehicle", wrong, "-o", tmp_path / "out")
    assert done.code == 2 and "[nodes.rigth]: the log has no such node, did you mean 'right'?" in done.err
    done = hubodo("fuse", log, "--vehicle", tmp_path / "model.toml", "--topic", "links=/left/imu", "-o", "o")
    assert done.code == 2 and "no node of the vehicle has this name" in done.err
    for arguments, text in (
        ((log, "--vehicle", log), "is a log, and a TOML file is due"),
        ((wrong, "--vehicle", wrong), "is a TOML file, and a log is due"),
        ((log, "--vehicle", wrong, "--calibration", wrong), "describes a vehicle, and a calibration is due"),
    ):
        done = hubodo("fuse", *arguments, "-o", tmp_path / "out")
        assert (done.code, text in done.err) == (2, True), done.err
