"""`hubodo vehicle` and `hubodo example`."""

import io
import json
import sys

import pytest

from hubodo.vehicle import Vehicle, load_vehicle
from hubodo.vehicle_sketch import draw_vehicle
from in_process import hubodo


class Terminal(io.StringIO):
    """Standard input on which somebody types."""

    def isatty(self):
        return True


def test_a_vehicle_file_is_written_from_sizes_in_any_unit(tmp_path):
    path = tmp_path / "v.toml"
    words = (
        "--diameter",
        "13 in",
        "--track",
        "55 cm",
        "--right-facing",
        "outwards",
        "--radius-from",
        "tape",
        "-o",
        path,
    )
    done = hubodo("vehicle", "new", *words, "--json")
    assert done.code == 0, done.err
    vehicle = load_vehicle(path)
    assert vehicle.wheel_radius == json.loads(done.out)["wheel_radius"] == pytest.approx(0.1651)
    assert vehicle.radius_from == "tape"
    assert (vehicle.track_width, vehicle.nodes["right"].facing) == (0.55, "right")
    assert hubodo("vehicle", "new", *words).code == 2
    assert hubodo("vehicle", "new", *words, "--force").code == 0


def test_what_is_missing_is_asked_for_until_it_is_plausible(tmp_path, monkeypatch):
    path = tmp_path / "v.toml"
    monkeypatch.setattr(sys, "stdin", Terminal("33\n33 m\n33 cm radius\n80 cm\ninwards\nwhat\nnone\n"))
    done = hubodo("vehicle", "new", "-o", path)
    assert done.code == 0, done.err
    vehicle = load_vehicle(path)
    assert (vehicle.wheel_radius, vehicle.track_width) == (0.33, 0.8)
    assert {name: mount.facing for name, mount in vehicle.nodes.items()} == {"left": "right"}
    assert "write a number and its unit" in done.err and "is hardly meant" in done.err


def test_without_a_terminal_a_missing_size_is_named(tmp_path):
    done = hubodo("vehicle", "new", "--track", "55 cm", "-o", tmp_path / "v.toml")
    assert (done.code, "--diameter is missing" in done.err) == (2, True)
    assert not (tmp_path / "v.toml").exists()


def test_the_sketch_shows_where_z_points_on_each_side():
    from hubodo.vehicle import NodeMount

    nodes = {"a": NodeMount("left", "left"), "b": NodeMount("right", "right"), "c": NodeMount()}
    text = "\n".join(draw_vehicle(Vehicle(0.165, 0.55, nodes)))
    assert "← z │ L ├─────55 cm─────┤ R │ z →" in text
    assert "diameter 33 cm" in text and "node c: on the body" in text


def test_the_example_files_are_used_by_the_commands_of_their_help(tmp_path, monkeypatch):
    short = {"drive.mcap": ("random", 20.0), "night.mcap": ("rest", 10.0)}
    monkeypatch.setattr("hubodo.demo.example_files.LOGS", short)
    assert hubodo("example", tmp_path).code == 0
    assert hubodo("example", tmp_path).code == 2
    done = hubodo("fuse", tmp_path / "drive.mcap", "-o", tmp_path / "out", "--json")
    assert json.loads(done.out)["truth"]["final_percent"] < 1.0, done.err
    done = hubodo("vehicle", "check", tmp_path / "vehicle.toml", tmp_path / "night.mcap", "--push", "2m")
    assert (done.code, "push further" in done.err) == (2, True)
