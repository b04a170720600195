"""`hubodo fuse` on logs in which something is wrong: larger sigmas that say why, or one clear line."""

import csv
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from generators import wheel_drives
from generators.fake_drive import VEHICLE_TOML
from generators.gnss_drives import geodetic
from hubodo.cli import main
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table

SEED = 21
REST = (6.0, 0.0, 0.0)
MOVING = [(8.0, 1.2, 0.2), (8.0, 1.4, -0.3), (8.0, 1.0, 0.25), (8.0, 1.3, -0.1)]
END = (2.0, 0.0, 0.0)
COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")
ORIGIN = (47.37, 8.54)


@dataclass(frozen=True)
class Found:
    """What `fuse` made: fuse.json, the columns of track.csv, and the sigma of the place at its end, m."""

    json: dict
    track: dict[str, np.ndarray]
    sigma: float

    @property
    def warnings(self) -> str:
        return "\n".join(self.json["warnings"])

    @property
    def covered(self) -> bool:
        """Whether the truth at the end is within three sigma."""
        return self.json["truth"]["final_error"] < 3.0 * self.sigma


@dataclass(frozen=True)
class Folder:
    """Runs `fuse` on a recording."""

    path: Path
    capsys: pytest.CaptureFixture | None = None

    def fuse(self, recording: Recording, *words: str) -> Found:
        assert self.code(recording, *words) == 0
        result = json.loads((self.path / "out" / "fuse.json").read_text())
        with (self.path / "out" / "track.csv").open() as file:
            head, *rows = csv.reader(file)
        track = dict(zip(head, np.array(rows, float).T, strict=True))
        return Found(result, track, float(np.hypot(track["sigma_x"][-1], track["sigma_y"][-1])))

    def refused(self, recording: Recording, *words: str) -> str:
        assert self.code(recording, *words) == 2
        complaint = self.capsys.readouterr().err
        assert complaint.count("\n") == 1
        assert not (self.path / "out").exists()
        return complaint

    def code(self, recording: Recording, *words: str) -> int:
        log, vehicle = self.path / "log.mcap", self.path / "vehicle.toml"
        log.unlink(missing_ok=True)
        write_recording(recording, log)
        vehicle.write_text(VEHICLE_TOML)
        out = ("-o", str(self.path / "out"), "--force", "--json")
        return main(["fuse", str(log), "--vehicle", str(vehicle), *out, *words])


@pytest.fixture
def folder(tmp_path, capsys):
    return Folder(tmp_path, capsys)


@pytest.fixture(scope="module")
def whole(sound, tmp_path_factory):
    """What is made of a log in which nothing is wrong."""
    return Folder(tmp_path_factory.mktemp("sound")).fuse(sound)


@pytest.fixture(scope="module")
def whole_with_fixes(with_fixes, tmp_path_factory):
    return Folder(tmp_path_factory.mktemp("fixes")).fuse(with_fixes)


def driven(parts=(REST, *MOVING, END), **options):
    rng = np.random.default_rng(SEED)
    return wheel_drives.drive(wheel_drives.legs(list(parts)), rng, **options)


def recorded(drive):
    nodes = {
        name: Table(dict(zip(COLUMNS, np.column_stack([node.t, node.gyro, node.accel]).T, strict=True)))
        for name, node in drive.nodes.items()
    }
    truth = {"t": drive.t[::10], "x": drive.x[::10], "y": drive.y[::10], "heading": drive.heading[::10]}
    return Recording(nodes, truth=Table(truth))


@pytest.fixture(scope="module")
def drive():
    return driven()


@pytest.fixture(scope="module")
def sound(drive):
    return recorded(drive)


@pytest.fixture(scope="module")
def with_fixes(drive, sound):
    """The same with fixes of 1.5 m at 5 Hz."""
    rng = np.random.default_rng(SEED)
    t = np.arange(0.05, drive.t[-1], 0.2)
    x, y = (np.interp(t, drive.t, v) + 1.5 * rng.standard_normal(len(t)) for v in (drive.x, drive.y))
    latitude, longitude = geodetic(x, y, *ORIGIN)
    columns = {"t": t, "latitude_deg": latitude, "longitude_deg": longitude, "altitude": 400.0 + 0.0 * t}
    return replace(sound, gnss=Table({**columns, "sigma": np.full(len(t), 1.5)}))


def changed(table, **columns):
    return Table({**table.columns, **columns})


def test_a_sound_log_says_nothing(whole, whole_with_fixes):
    for found in (whole, whole_with_fixes):
        assert found.json["warnings"] == []
        assert found.covered


def test_without_a_rest_at_the_start_the_heading_is_less_sure_and_that_is_said(folder, whole):
    found = folder.fuse(recorded(driven([*MOVING, END])))
    assert "no rest at the start" in found.warnings
    assert found.track["sigma_heading"][-1] > 1.05 * whole.track["sigma_heading"][-1]
    assert found.covered
    # The heading at the start is that of the truth where the first window begins, not at the first sample.
    assert found.json["truth"]["heading_rms"] < 0.01


@pytest.mark.parametrize("parts", [[(20.0, 0.0, 0.0)], [REST, (10.0, 0.2, 0.8), (10.0, 0.125, 0.5), END]])
def test_a_wheel_that_never_turns_is_named(folder, parts):
    """At rest, and on the spot about the left wheel."""
    found = folder.fuse(recorded(driven(parts)))
    assert "left: the wheel turned only 0.0" in found.warnings
    assert found.json["truth"]["final_error"] < max(3.0 * found.sigma, 0.01)
    scale = found.json["nodes"]["left"]["gyro_scale_factor"]["z"]
    assert scale["sigma"] == pytest.approx(0.015, rel=0.1)


@pytest.mark.parametrize("begin", [0.0, 20.0])
def test_a_node_that_freezes_is_found_and_the_other_carries_on(folder, sound, begin, whole):
    left = sound.nodes["left"]
    at = np.maximum(np.searchsorted(left.t, begin), 1) - 1
    frozen = {name: np.where(left.t > begin, v[at], v) for name, v in left.columns.items() if name != "t"}
    found = folder.fuse(replace(sound, nodes={**sound.nodes, "left": changed(left, **frozen)}))
    assert "it froze" in found.warnings
    assert found.sigma > whole.sigma
    assert found.covered


@pytest.mark.parametrize("node", ["left", "right"])
def test_a_node_mounted_the_wrong_way_round_is_found_named_and_costs_sigma(folder, node, whole):
    found = folder.fuse(recorded(driven(facing={node: "right"})))
    assert f"the node on the {node} wheel is mounted the other way round" in found.warnings
    # The other one alone tells the way from the start.
    assert found.sigma > 1.3 * whole.sigma
    assert found.covered


def test_both_nodes_the_wrong_way_round_are_named(folder):
    found = folder.fuse(recorded(driven(facing={"left": "right", "right": "right"})))
    assert "both nodes are mounted the other way round" in found.warnings
    assert found.covered


def test_exchanged_sides_are_named(folder, sound):
    left, right = sound.nodes["left"], sound.nodes["right"]
    found = folder.fuse(replace(sound, nodes={"left": right, "right": left}))
    assert "sides of the two nodes are exchanged" in found.warnings
    assert found.covered


def test_one_node_alone_the_wrong_way_round_does_not_know_ahead_from_behind(folder):
    found = folder.fuse(recorded(driven(facing={"left": "right"})), "--nodes", "left")
    assert "rolled backwards nearly all the way" in found.warnings
    assert found.sigma > 10.0
    assert found.covered


def test_a_missing_node_is_said_and_costs_sigma(folder, sound, whole):
    found = folder.fuse(replace(sound, nodes={"left": sound.nodes["left"]}))
    assert "right: not in the log" in found.warnings
    assert found.sigma > whole.sigma
    assert found.covered
    assert "track_width" not in found.json["vehicle"]


def stepped(table, at, by):
    """The clock steps by so many s; the rows by time, as a log's reader gives them."""
    t = np.where(table.t > at, table.t + by, table.t)
    order = np.argsort(t, kind="stable")
    order = order[np.append(True, np.diff(t[order]) > 0.0)]
    return Table({name: (t if name == "t" else v)[order] for name, v in table.columns.items()})


@pytest.mark.parametrize("by", [-5.0, -0.3, 0.3, 5.0])
def test_the_clock_of_one_node_that_jumps_is_said_and_the_other_carries_on(folder, sound, by, whole):
    left = stepped(sound.nodes["left"], 20.0, by)
    found = folder.fuse(replace(sound, nodes={**sound.nodes, "left": left}))
    assert "left: " in found.warnings
    assert "clock jumped" in found.warnings or "clock went back" in found.warnings
    assert found.sigma > whole.sigma
    assert found.covered


@pytest.mark.parametrize("by", [-5.0, -0.3, 0.3, 5.0])
def test_clocks_that_jump_together_leave_a_hole_that_the_sigma_tells(folder, sound, by, whole):
    nodes = {name: stepped(table, 20.0, by) for name, table in sound.nodes.items()}
    # The truth stays on the clock of before, so it is right up to the jump alone.
    before = {name: v[sound.truth.t < min(20.0, 20.0 + by)] for name, v in sound.truth.columns.items()}
    found = folder.fuse(replace(sound, nodes=nodes, truth=Table(before)))
    assert "clock jumped" in found.warnings or "not heard" in found.warnings
    # In 0.3 s a vehicle turns by 3 degrees, in 5 s by 60.
    assert found.sigma > (5.0 if abs(by) < 1.0 else 50.0) * whole.sigma
    assert found.track["sigma_heading"][-1] > 10.0 * whole.track["sigma_heading"][-1]
    assert found.json["truth"]["final_error"] < 0.1


def test_a_clock_that_jumps_by_more_than_an_hour_is_a_pause(folder, sound):
    nodes = {name: stepped(table, 20.0, 4000.0) for name, table in sound.nodes.items()}
    found = folder.fuse(replace(sound, nodes=nodes))
    assert "left and right: not heard from t = 19.9" in found.warnings
    assert "where it went is not known" in found.warnings
    assert found.track["t"][-1] > 4030.0
    assert 30.0 < found.sigma < 1000.0
    (pause,) = found.json["silences"]
    assert pause["end"] - pause["begin"] == pytest.approx(4000.0, abs=0.3)
    assert pause["stood"] is False


@pytest.mark.parametrize(("begin", "end"), [(20.0, 28.0), (20.0, 99.0), (20.0, 20.2)])
def test_fixes_that_jump_by_100_m_are_left_out_said_and_missed(
    folder, with_fixes, begin, end, whole_with_fixes
):
    fixes = with_fixes.gnss
    away = np.where((fixes.t > begin) & (fixes.t <= end), 100.0, 0.0)
    latitude, _ = geodetic(0.0, away, fixes["latitude_deg"], fixes["longitude_deg"])
    moved = changed(fixes, latitude_deg=latitude)
    found = folder.fuse(replace(with_fixes, gnss=moved))
    assert "jumped, by 1" in found.warnings
    assert found.sigma > whole_with_fixes.sigma
    assert found.covered


@pytest.mark.parametrize("latitude", [91.0, -1234.0])
def test_a_latitude_that_is_none_costs_its_fix_and_is_said(folder, with_fixes, latitude, whole_with_fixes):
    fixes = with_fixes.gnss
    half = np.where(np.arange(len(fixes)) < len(fixes) // 2, latitude, fixes["latitude_deg"])
    found = folder.fuse(replace(with_fixes, gnss=changed(fixes, latitude_deg=half)))
    assert "are not on Earth" in found.warnings
    assert found.sigma > whole_with_fixes.sigma
    assert found.covered


def test_fixes_none_of_which_is_on_earth_are_one_clear_line(folder, with_fixes):
    nowhere = np.full(len(with_fixes.gnss), 91.0)
    recording = replace(with_fixes, gnss=changed(with_fixes.gnss, latitude_deg=nowhere))
    assert "not on Earth" in folder.refused(recording)


def test_one_fix_places_the_track_and_no_more(folder, with_fixes, whole):
    one = Table({name: v[100:101] for name, v in with_fixes.gnss.columns.items()})
    found = folder.fuse(replace(with_fixes, gnss=one))
    assert "one fix only" in found.warnings
    assert found.sigma > whole.sigma
    assert found.covered


def test_fixes_of_another_time_are_one_clear_line(folder, with_fixes):
    late = changed(with_fixes.gnss, t=with_fixes.gnss.t + 1000.0)
    assert "outside the odometry" in folder.refused(replace(with_fixes, gnss=late))


def test_a_receiver_whose_clock_jumps_is_said_and_costs_sigma(folder, with_fixes, whole_with_fixes):
    fixes = with_fixes.gnss
    found = folder.fuse(replace(with_fixes, gnss=changed(fixes, t=fixes.t + 3.0 * (fixes.t > 20.0))))
    assert "sigmas were widened" in found.warnings
    assert found.sigma > 1.3 * whole_with_fixes.sigma
    assert found.covered


@pytest.mark.parametrize(
    ("columns", "share", "words"),
    [(("gx", "gy", "gz"), 180.0 / np.pi, "--unit deg/s"), (("ax", "ay", "az"), 1 / 9.80665, "--unit g")],
    ids=["degrees per second", "g"],
)
def test_a_node_in_other_units_is_refused_and_put_right_when_told(
    folder, whole, sound, columns, share, words
):
    left = sound.nodes["left"]
    other = changed(left, **{name: left[name] * share for name in columns})
    right = sound.nodes["right"]
    wrong = replace(
        sound,
        nodes={"left": other, "right": changed(right, **{name: right[name] * share for name in columns})},
    )
    assert words in folder.refused(wrong)
    told = folder.fuse(wrong, *words.split())
    assert told.track["x"][-1] == pytest.approx(whole.track["x"][-1], abs=1e-3)
