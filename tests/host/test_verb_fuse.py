"""`hubodo fuse` on recordings whose path is known by hand."""

import json

import numpy as np
import pytest

from hubodo.cli import main
from hubodo.log.convert import write_recording
from hubodo.log.recording import Recording, Table

VEHICLE = """
[vehicle]
wheel_radius = 0.25
track_width = 0.8
[nodes.left]
side = "left"
facing = "left"
[nodes.right]
side = "right"
facing = "right"
"""
G = 9.80665


def circle(turns: float = 1.0, rest: float = 3.0) -> Recording:
    """Rest, then a circle of 2 m radius at 1 m/s, written down by hand; the right node faces right."""
    rate = 200.0
    yaw = 0.5
    t = np.arange(0.0, rest + turns * 2 * np.pi / yaw, 1 / rate)
    going = t >= rest
    nodes = {}
    for name, y, sign in (("left", 0.4, 1.0), ("right", -0.4, -1.0)):
        spin = np.where(going, (1.0 - yaw * y) / 0.25, 0.0)
        angle = np.cumsum(spin) / rate
        bias = 0.013
        nodes[name] = Table(
            {
                "t": t,
                "gx": np.where(going, yaw * np.cos(angle), 0.0),
                "gy": np.where(going, -sign * yaw * np.sin(angle), 0.0),
                "gz": sign * spin + bias,
                "ax": G * np.cos(angle),
                "ay": -sign * G * np.sin(angle),
                "az": np.zeros_like(t),
            }
        )
    heading = 0.3 + np.where(going, yaw * (t - rest), 0.0)
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


def call(folder, *words):
    log, vehicle = str(folder / "log.mcap"), str(folder / "vehicle.toml")
    return main(["fuse", log, "--vehicle", vehicle, "-o", str(folder / "out"), *words])


def test_a_circle_closes_and_its_error_is_scored_against_the_truth(folder, capsys):
    assert call(folder, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads((folder / "out" / "fuse.json").read_text())
    assert result["distance"] == pytest.approx(4 * np.pi, rel=2e-3)
    assert result["truth"]["final_error"] < 0.03
    assert result["truth"]["heading_rms"] < 0.01
    for side in ("left", "right"):
        assert result["gyro_bias"][side]["value"] == pytest.approx(0.013, abs=1e-3)


def test_the_track_begins_at_the_origin_with_the_heading_of_the_truth(folder):
    assert call(folder) == 0
    lines = (folder / "out" / "track.csv").read_text().splitlines()
    assert lines[0] == "t,x,y,heading,speed,sigma_x,sigma_y,sigma_heading"
    first = [float(cell) for cell in lines[1].split(",")]
    assert first[1:3] == [0.0, 0.0]
    assert first[3] == pytest.approx(0.3)


def test_a_log_without_truth_claims_no_error(tmp_path, capsys):
    recording = circle()
    write_recording(Recording(recording.nodes), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE)
    assert call(tmp_path, "--json") == 0
    assert "truth" not in json.loads(capsys.readouterr().out)


def test_results_are_not_overwritten_without_force(folder, capsys):
    assert call(folder) == 0
    assert call(folder) == 2
    assert "exists" in capsys.readouterr().err
    assert call(folder, "--force") == 0


def test_a_missing_node_is_one_clear_line_and_leaves_nothing(tmp_path, capsys):
    write_recording(Recording({"left": circle().nodes["left"]}), tmp_path / "log.mcap")
    (tmp_path / "vehicle.toml").write_text(VEHICLE.replace("[nodes.right]", "[nodes.other]"))
    assert call(tmp_path) == 2
    complaint = capsys.readouterr().err
    assert complaint.count("\n") == 1
    assert "other" in complaint
    assert "there: left" in complaint
    assert not (tmp_path / "out").exists()
