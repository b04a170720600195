"""`hubodo north --live` in virtual time: a node is recorded while a table, or a hand, turns it."""

import io
import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from fakes.fake_node import FakeNode
from fakes.fake_table import FakeTable
from hubodo.cli import main
from hubodo.ingest.live import node_stream
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.log.recording_reader import read_recording
from hubodo.verbs import north_live
from repetitions import first_and_more

LATITUDE_DEG = 48.1
# Horizontal Earth rate at that latitude: 15.041 deg/h times the cosine.
LEVEL_DEG_S = 15.041067 / 3600 * math.cos(math.radians(LATITUDE_DEG))
STEP_NDPS = 200_000
"""A fine gyro: Earth's 2.8e-3 deg/s are 14 steps of 2e-4 deg/s."""
NOISE_STEPS = 4.0


class FineNode(FakeNode):
    """A fake node with a finer gyro than that of a hub."""

    def hello(self):
        return replace(super().hello(), gyro_lsb_ndps=STEP_NDPS)


@dataclass
class OnTable(Sequence):
    """Raw samples of a node on the table, x along table zero, computed when they are requested."""

    table: FakeTable
    azimuth_deg: float
    seed: int

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)

    def __len__(self):
        return 1 << 40

    def __getitem__(self, number):
        gyro = self.rng.normal(0.0, NOISE_STEPS, 3)
        at = math.radians(self.azimuth_deg - self.table.at)
        level = LEVEL_DEG_S / (STEP_NDPS * 1e-9)
        # x points along the table's angle, y a quarter turn anticlockwise of it; all axes have a bias.
        gyro += 300.0 + np.array([level * math.cos(at), level * math.cos(at - math.pi / 2), 0.0])
        return (*np.rint(gyro).astype(int).tolist(), *self.rng.integers(-3, 4, 2).tolist(), 2048)


def north(node, capsys, *words):
    common = ["--latitude-deg", LATITUDE_DEG, "--settle", 0.2, "--json"]
    status = main(["north", "--live", node.path, *map(str, [*common, *words])])
    out, err = capsys.readouterr()
    return json.loads(out) if status == 0 else (status, err)


def off_by(result, azimuth_deg):
    return (result["azimuth_deg"] - azimuth_deg + 180.0) % 360.0 - 180.0


@pytest.fixture
def computer(monkeypatch):
    built = VirtualComputer()
    monkeypatch.setattr(node_stream, "ThisComputer", lambda: built)
    return built


def lasting(computer):
    """Let a turn last 50 ms of this computer's time."""

    def wait(*_):
        end_ns = computer.now_ns() + 50_000_000
        while computer.now_ns() < end_ns:
            time.sleep(0.001)

    return wait


@pytest.fixture
def turning(computer):
    return lasting(computer)


@pytest.fixture
def table(turning):
    with FakeTable(turning=turning) as built:
        yield built


def test_the_table_turns_from_stop_to_stop_and_the_log_is_saved(table, computer, tmp_path, capsys):
    azimuth, out = 222.0, tmp_path / "north.mcap"
    words = ["--table", table.path, "--method", "maytag4", "--stop", 1.2, "--stops", 8, "-o", out]
    with FineNode(rows=OnTable(table, azimuth, 1), computer=computer) as node:
        result = north(node, capsys, *words)
    assert abs(off_by(result, azimuth)) < 4 * result["sigma_deg"] < 80
    # The table turns the shorter way: 270 degrees after 90 are -90 from the first zero.
    assert [angle % 360 for angle in table.visited] == [0, 180, 90, 270, 0, 180, 90, 270]
    assert all(abs(b - a) <= 180 for a, b in pairwise(table.visited))
    assert result["output"] == str(out) and result["gyros"][0]["stops"]["count"] == 8
    # The recorded log gives the same answer, and contains the raw frames as well.
    words = ["north", str(out), "--latitude_deg", str(LATITUDE_DEG), "--method", "maytag4"]
    assert main([*words, "--settle", "0.2", "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["azimuth_deg"] == result["azimuth_deg"] and again["sigma_deg"] == result["sigma_deg"]
    log = read_recording(out)
    print(result["azimuth_deg"], result["sigma_deg"])
    assert set(log.table["moving"]) == {0.0, 1.0} and len(log.nodes["left"]) > 8 * 1.2 * 200


def test_the_axis_is_turned_until_it_points_east_and_left_there(table, computer, capsys):
    azimuth = 75.0
    words = ["--table", table.path, "--method", "east", "--stop", 1.0, "--stops", 15, "--axis", "y"]
    with FineNode(rows=OnTable(table, azimuth, 2), computer=computer) as node:
        result = north(node, capsys, *words)
    east = result["east"]
    print(result["azimuth_deg"], result["sigma_deg"], east["table_angle_deg"])
    assert len(east["steps"]) == 5
    assert table.at % 360 == pytest.approx(east["table_angle_deg"], abs=1e-3)
    # y points a quarter turn anticlockwise of the table's angle, to azimuth - angle - 90; east is 90.
    points = (azimuth - east["table_angle_deg"] - 90.0) % 360.0
    assert abs((points - 90.0 + 180.0) % 360.0 - 180.0) < 4 * result["sigma_deg"] < 80
    assert abs(off_by(result, azimuth)) < 4 * result["sigma_deg"]


def test_without_a_table_port_the_operator_gets_instructions(table, computer, turning, capsys, monkeypatch):
    class Hand(io.StringIO):
        """Read the prompt on stderr and turn the table accordingly."""

        def readline(self, *_):
            asked = capsys.readouterr().err
            reported.append(asked.rpartition("turn the table")[2])
            turning()
            table.at = float(reported[-1].partition(" on its scale")[0].split()[-1].rstrip("°"))
            return "\n"

    reported = []
    monkeypatch.setattr("sys.stdin", Hand())
    with FineNode(rows=OnTable(table, 10.0, 3), computer=computer) as node:
        result = north(node, capsys, "--method", "maytag", "--stop", 1.0, "--stops", 6, "--near-deg", 10)
    assert abs(off_by(result, 10.0)) < 4 * result["sigma_deg"]
    assert len(reported) == 6 and all("press Enter" in line for line in reported)
    assert "by 180.0° anticlockwise" in reported[1] and "by 180.0° clockwise" in reported[2]


@pytest.mark.parametrize(
    "words, text",
    [
        (["--method", "carousel"], "--live makes stops"),
        (["--stops", 3], "give at least 4 stops"),
        (["--stop", 0.5], "give at least 4 stops of at least 1 s"),
        (["--method", "east", "--stops", 11], "at least 12"),
        (["--method", "east", "--axis", "x", "--axis", "y"], "give one --axis"),
        (["--simulate-azimuth-deg", 10], "goes with a LOG"),
        (["-o", "north.csv"], "the suffix .mcap"),
        (["--node", "frame"], "carries node 'left', not 'frame'"),
        (["--axis", "z"], "degrees from level"),
    ],
)
def test_options_without_a_live_mode_are_refused_in_one_line(table, computer, capsys, words, text):
    with FineNode(rows=OnTable(table, 0.0, 4), computer=computer) as node:
        status, err = north(node, capsys, "--table", table.path, *words)
    assert status == 2 and text in err.splitlines()[-1]
    assert len(table.visited) <= 1


@pytest.mark.parametrize(
    "body, text",
    [
        ("[nodes.left]\nserial = 'aa55'\n", "is for the node with serial aa55"),
        ("[nodes.right]\n", "holds no node 'left'; it has right"),
    ],
)
def test_a_calibration_of_another_node_is_refused_before_all_the_stops(
    table, computer, tmp_path, capsys, body, text
):
    (tmp_path / "c.toml").write_text(body)
    with FineNode(rows=OnTable(table, 0.0, 5), computer=computer) as node:
        status, err = north(node, capsys, "--table", table.path, "--calibration", tmp_path / "c.toml")
    assert status == 2 and text in err.splitlines()[-1]
    assert len(table.visited) <= 1


def test_a_log_and_live_exclude_each_other(tmp_path, capsys):
    for words in ([], [str(tmp_path), "--live", "/dev/null"], [str(tmp_path), "--table", "/dev/null"]):
        assert main(["north", *words, "--latitude-deg", "48"]) == 2
        assert "--live PORT" in capsys.readouterr().err


@pytest.mark.parametrize("fault, text", [({"jammed": True}, "ERR jammed"), ({"off": 3.0}, "stopped at")])
def test_a_fault_of_the_table_ends_the_run_and_keeps_the_recording(
    computer, turning, tmp_path, capsys, fault, text
):
    out = tmp_path / "north.mcap"
    with (
        FakeTable(**fault, good=1, turning=turning) as table,
        FineNode(rows=OnTable(table, 0.0, 5), computer=computer) as node,
    ):
        status, err = north(node, capsys, "--table", table.path, "--stops", 4, "--stop", 1.0, "-o", out)
    assert status == 1 and text in err.splitlines()[-1]
    log = read_recording(out)
    assert len(log.nodes["left"]) > 200 and log.table["moving"].tolist() == [0.0, 1.0]


def test_it_ends_when_sigma_is_reached(table, computer, capsys):
    words = ["--table", table.path, "--method", "maytag4", "--stop", 1.2, "--stops", 40, "--sigma-deg", 20]
    with FineNode(rows=OnTable(table, 300.0, 7), computer=computer) as node:
        result = north(node, capsys, *words)
    count = result["gyros"][0]["stops"]["count"]
    print(count, result["azimuth_deg"], result["sigma_deg"])
    assert count < 40 and count % 4 == 0 and result["sigma_deg"] < 22
    assert abs(off_by(result, 300.0)) < 4 * result["sigma_deg"]


@pytest.mark.parametrize("method", first_and_more("maytag4", "east"))
def test_an_interrupted_run_is_continued_from_its_log(
    computer, turning, tmp_path, capsys, monkeypatch, method
):
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    words = ["--stop", 1.2, "--method", method, "--stops", 12]
    azimuth = 140.0
    with (
        FakeTable(jammed=True, good=7, turning=turning) as table,
        FineNode(rows=OnTable(table, azimuth, 8), computer=computer) as node,
    ):
        status, err = north(node, capsys, "--table", table.path, *words, "-o", first)
    assert status == 1 and f"continue with --resume {first}" in err
    later = VirtualComputer()
    monkeypatch.setattr(node_stream, "ThisComputer", lambda: later)
    with (
        FakeTable(turning=lasting(later)) as table,
        FineNode(rows=OnTable(table, azimuth, 9), computer=later) as node,
    ):
        result = north(node, capsys, "--table", table.path, *words, "--resume", first, "-o", second)
    assert isinstance(result, dict), result
    stops = result["gyros"][0]["stops"]["count"]
    assert stops == (7 + 12 if method == "maytag4" else stops) and stops > 14
    assert abs(off_by(result, azimuth)) < 4 * result["sigma_deg"] < 100
    if method == "maytag4":
        again = ["north", str(first), str(second), "--latitude-deg", str(LATITUDE_DEG), "--method", method]
        assert main([*again, "--settle", "0.2", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["azimuth_deg"] == result["azimuth_deg"]


def test_a_device_that_is_no_table_is_reported_before_recording(computer, tmp_path, capsys, monkeypatch):
    out = tmp_path / "north.mcap"
    monkeypatch.setattr(north_live, "TABLE_TIMEOUT_S", 0.1)
    with FakeTable(silent=True) as table, FineNode(computer=computer) as node:
        status, err = north(node, capsys, "--table", table.path, "-o", out)
        assert status == 1 and "answered nothing to 'TABLE?'" in err
        status, err = north(node, capsys, "--table", tmp_path / "none", "-o", out)
        assert status == 1 and "--table" in err and err.count("\n") == 1
    assert not out.exists()


def test_a_node_that_stops_sending_is_reported(table, computer, capsys):
    with FineNode(rows=OnTable(table, 0.0, 6), answers=False, computer=computer) as node:
        node.unplug()
        node.plug()
        node._streaming = False
        status, err = north(node, capsys, "--table", table.path, "--stops", 4, "--stop", 1.0)
    assert status == 1 and "no samples for 8 s" in err


def test_a_stop_with_too_few_samples_is_repeated_at_most_twice(table, computer, capsys):
    words = ["--table", table.path, "--method", "maytag4", "--stop", 1, "--stops", 8]
    with FineNode(rows=OnTable(table, 0.0, 1), computer=computer, rate_hz=12.0, batch=2) as node:
        status, err = north(node, capsys, *words)
    assert status == 1 and err.count("samples in 1 s: measuring again") == 2
    assert "samples in 1 s, 3 times; hubodo doctor finds the cause of the losses" in err
