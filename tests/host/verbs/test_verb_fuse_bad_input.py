"""`hubodo fuse` on faulty logs: a warning with larger sigmas, or a refusal in one line."""

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
from repetitions import first_and_more

SEED = 21
STANDSTILL = (6.0, 0.0, 0.0)
MOVING = [(8.0, 1.2, 0.2), (8.0, 1.4, -0.3), (8.0, 1.0, 0.25), (8.0, 1.3, -0.1)]
END = (2.0, 0.0, 0.0)
COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")
ORIGIN = (47.37, 8.54)


@dataclass(frozen=True)
class FuseResult:
    """The result of `fuse`: fuse.json, the columns of track.csv, and the sigma of the final position in m."""

    json: dict
    track: dict[str, np.ndarray]
    sigma: float

    @property
    def warnings(self) -> str:
        return "\n".join(self.json["warnings"])

    @property
    def is_within_3_sigma(self) -> bool:
        """Return True if the final position error is within three sigma."""
        return self.json["truth"]["final_error"] < 3.0 * self.sigma


@dataclass(frozen=True)
class Folder:
    """A folder in which `fuse` runs on a recording."""

    path: Path
    capsys: pytest.CaptureFixture | None = None

    def fuse(self, recording: Recording, *arguments: str) -> FuseResult:
        assert self.exit_code(recording, *arguments) == 0
        result = json.loads((self.path / "out" / "fuse.json").read_text())
        with (self.path / "out" / "track.csv").open() as file:
            head, *rows = csv.reader(file)
        track = dict(zip(head, np.array(rows, float).T, strict=True))
        return FuseResult(result, track, float(np.hypot(track["sigma_x"][-1], track["sigma_y"][-1])))

    def refusal(self, recording: Recording, *arguments: str) -> str:
        assert self.exit_code(recording, *arguments) == 2
        error = self.capsys.readouterr().err
        assert error.count("\n") == 1
        assert not (self.path / "out").exists()
        return error

    def exit_code(self, recording: Recording, *arguments: str) -> int:
        log, vehicle = self.path / "log.mcap", self.path / "vehicle.toml"
        log.unlink(missing_ok=True)
        write_recording(recording, log)
        vehicle.write_text(VEHICLE_TOML)
        out = ("-o", str(self.path / "out"), "--force", "--json")
        return main(["fuse", str(log), "--vehicle", str(vehicle), *out, *arguments])


@pytest.fixture
def folder(tmp_path, capsys):
    return Folder(tmp_path, capsys)


@pytest.fixture(scope="module")
def valid_result(valid_recording, tmp_path_factory):
    """Return the result of a log without faults."""
    return Folder(tmp_path_factory.mktemp("sound")).fuse(valid_recording)


@pytest.fixture(scope="module")
def valid_result_with_fixes(with_fixes, tmp_path_factory):
    return Folder(tmp_path_factory.mktemp("fixes")).fuse(with_fixes)


def simulate_drive(parts=(STANDSTILL, *MOVING, END), **options):
    rng = np.random.default_rng(SEED)
    return wheel_drives.drive(wheel_drives.legs(list(parts)), rng, **options)


def to_recording(drive):
    nodes = {
        name: Table(dict(zip(COLUMNS, np.column_stack([node.t, node.gyro, node.accel]).T, strict=True)))
        for name, node in drive.nodes.items()
    }
    truth = {"t": drive.t[::10], "x": drive.x[::10], "y": drive.y[::10], "heading": drive.heading[::10]}
    return Recording(nodes, truth=Table(truth))


@pytest.fixture(scope="module")
def drive():
    return simulate_drive()


@pytest.fixture(scope="module")
def valid_recording(drive):
    return to_recording(drive)


@pytest.fixture(scope="module")
def with_fixes(drive, valid_recording):
    """Return the valid recording with GNSS fixes of 1.5 m (1 sigma) at 5 Hz."""
    rng = np.random.default_rng(SEED)
    t = np.arange(0.05, drive.t[-1], 0.2)
    x, y = (np.interp(t, drive.t, v) + 1.5 * rng.standard_normal(len(t)) for v in (drive.x, drive.y))
    latitude, longitude = geodetic(x, y, *ORIGIN)
    columns = {"t": t, "latitude_deg": latitude, "longitude_deg": longitude, "altitude": 400.0 + 0.0 * t}
    return replace(valid_recording, gnss=Table({**columns, "sigma": np.full(len(t), 1.5)}))


def with_columns(table, **columns):
    return Table({**table.columns, **columns})


def test_a_valid_log_gives_no_warning(valid_result, valid_result_with_fixes):
    for result in (valid_result, valid_result_with_fixes):
        assert result.json["warnings"] == []
        assert result.is_within_3_sigma


def test_without_an_initial_standstill_the_heading_sigma_is_larger_with_a_warning(folder, valid_result):
    result = folder.fuse(to_recording(simulate_drive([*MOVING, END])))
    assert "no rest at the start" in result.warnings
    assert result.track["sigma_heading"][-1] > 1.05 * valid_result.track["sigma_heading"][-1]
    assert result.is_within_3_sigma
    # The initial heading is that of the truth at the first window, not at the first sample.
    assert result.json["truth"]["heading_rms"] < 0.01


def test_a_wrong_heading_of_the_truth_is_distinguished_from_an_error_of_the_track(folder, valid_recording):
    truth = valid_recording.truth
    wrong = with_columns(truth, heading=truth["heading"] + np.radians(20.0))
    result = folder.fuse(replace(valid_recording, truth=wrong))
    assert "wrong heading" in result.warnings
    truth = result.json["truth"]
    assert truth["rotation"] == pytest.approx(np.radians(-20.0), abs=np.radians(0.5))
    assert truth["rotated_maximum_percent"] < 1.0 < truth["maximum_percent"]


@pytest.mark.parametrize(
    "parts", [[(20.0, 0.0, 0.0)], [STANDSTILL, (10.0, 0.2, 0.8), (10.0, 0.125, 0.5), END]]
)
def test_a_wheel_that_never_rolls_is_named(folder, parts):
    """The vehicle stands still, or turns on the spot about the left wheel."""
    result = folder.fuse(to_recording(simulate_drive(parts)))
    assert "left: the wheel turned only 0.0" in result.warnings
    assert result.json["truth"]["final_error"] < max(3.0 * result.sigma, 0.01)
    scale = result.json["nodes"]["left"]["gyro_scale_factor"]["z"]
    # Turns determine the common scale error of the axes, 1 %; the 0.7 % of the axis itself stay unknown.
    assert 0.007 < scale["sigma"] < 0.0125


@pytest.mark.parametrize("freeze_start", [0.0, 20.0])
def test_frozen_samples_of_a_node_are_detected_and_the_other_wheel_is_used(
    folder, valid_recording, freeze_start, valid_result
):
    left = valid_recording.nodes["left"]
    last_row = np.maximum(np.searchsorted(left.t, freeze_start), 1) - 1
    frozen = {
        name: np.where(left.t > freeze_start, v[last_row], v)
        for name, v in left.columns.items()
        if name != "t"
    }
    result = folder.fuse(
        replace(valid_recording, nodes={**valid_recording.nodes, "left": with_columns(left, **frozen)})
    )
    assert "it froze" in result.warnings
    assert result.sigma > valid_result.sigma
    assert result.is_within_3_sigma


@pytest.mark.parametrize("node", ["left", "right"])
def test_a_node_facing_the_wrong_way_is_named_and_sigma_increases(folder, node, valid_result):
    result = folder.fuse(to_recording(simulate_drive(facing={node: "right"})))
    assert f"the node on the {node} wheel is mounted the other way round" in result.warnings
    # The other wheel alone gives the distance from the start.
    assert result.sigma > 1.3 * valid_result.sigma
    assert result.is_within_3_sigma


def test_two_nodes_facing_the_wrong_way_are_named(folder):
    result = folder.fuse(to_recording(simulate_drive(facing={"left": "right", "right": "right"})))
    assert "both nodes are mounted the other way round" in result.warnings
    assert result.is_within_3_sigma


def test_exchanged_sides_are_named(folder, valid_recording):
    left, right = valid_recording.nodes["left"], valid_recording.nodes["right"]
    result = folder.fuse(replace(valid_recording, nodes={"left": right, "right": left}))
    assert "sides of the two nodes are exchanged" in result.warnings
    assert result.is_within_3_sigma


def test_with_one_node_a_wrong_facing_cannot_be_distinguished_from_driving_backwards(folder):
    result = folder.fuse(to_recording(simulate_drive(facing={"left": "right"})), "--nodes", "left")
    assert "rolled backwards nearly all the way" in result.warnings
    assert result.sigma > 10.0
    assert result.is_within_3_sigma


def test_a_missing_node_is_reported_and_sigma_increases(folder, valid_recording, valid_result):
    result = folder.fuse(replace(valid_recording, nodes={"left": valid_recording.nodes["left"]}))
    assert "right: not in the log" in result.warnings
    assert result.sigma > valid_result.sigma
    assert result.is_within_3_sigma
    assert "track_width" not in result.json["vehicle"]


def with_clock_step(table, at, step):
    """Return the table with a clock step of `step` s at time `at`, sorted by time."""
    t = np.where(table.t > at, table.t + step, table.t)
    order = np.argsort(t, kind="stable")
    order = order[np.append(True, np.diff(t[order]) > 0.0)]
    return Table({name: (t if name == "t" else v)[order] for name, v in table.columns.items()})


@pytest.mark.parametrize("step", [-5.0, 0.3])
def test_a_clock_step_of_one_node_is_reported_and_the_other_wheel_is_used(
    folder, valid_recording, step, valid_result
):
    left = with_clock_step(valid_recording.nodes["left"], 20.0, step)
    result = folder.fuse(replace(valid_recording, nodes={**valid_recording.nodes, "left": left}))
    assert "left: " in result.warnings
    assert "clock jumped" in result.warnings or "clock went back" in result.warnings
    assert result.sigma > valid_result.sigma
    assert result.is_within_3_sigma


@pytest.mark.parametrize("step", [-0.3, 5.0])
def test_a_clock_step_of_both_nodes_is_an_outage_that_increases_sigma(
    folder, valid_recording, step, valid_result
):
    nodes = {name: with_clock_step(table, 20.0, step) for name, table in valid_recording.nodes.items()}
    # The truth keeps the clock before the step, so it is valid only up to the step.
    before = {
        name: v[valid_recording.truth.t < min(20.0, 20.0 + step)]
        for name, v in valid_recording.truth.columns.items()
    }
    result = folder.fuse(replace(valid_recording, nodes=nodes, truth=Table(before)))
    assert "clock jumped" in result.warnings or "not heard" in result.warnings
    # A vehicle may turn by 3 degrees in 0.3 s, by 60 in 5 s.
    assert result.sigma > (5.0 if abs(step) < 1.0 else 50.0) * valid_result.sigma
    assert result.track["sigma_heading"][-1] > 10.0 * valid_result.track["sigma_heading"][-1]
    assert result.json["truth"]["final_error"] < 0.1


def test_a_clock_step_of_more_than_an_hour_is_an_outage_of_unknown_motion(folder, valid_recording):
    nodes = {name: with_clock_step(table, 20.0, 4000.0) for name, table in valid_recording.nodes.items()}
    result = folder.fuse(replace(valid_recording, nodes=nodes))
    assert "left and right: not heard from t = 19.9" in result.warnings
    assert "where it went is not known" in result.warnings
    assert result.track["t"][-1] > 4030.0
    assert 30.0 < result.sigma < 1000.0
    (pause,) = result.json["silences"]
    assert pause["end"] - pause["begin"] == pytest.approx(4000.0, abs=0.3)
    assert pause["stood"] is False


@pytest.mark.parametrize(("jump_start", "jump_end"), first_and_more((20.0, 99.0), (20.0, 28.0), (20.0, 20.2)))
def test_fixes_that_jump_by_100_m_are_rejected_with_a_warning_and_sigma_increases(
    folder, with_fixes, jump_start, jump_end, valid_result_with_fixes
):
    fixes = with_fixes.gnss
    north_offset = np.where((fixes.t > jump_start) & (fixes.t <= jump_end), 100.0, 0.0)
    latitude, _ = geodetic(0.0, north_offset, fixes["latitude_deg"], fixes["longitude_deg"])
    jumped = with_columns(fixes, latitude_deg=latitude)
    result = folder.fuse(replace(with_fixes, gnss=jumped))
    assert "jumped, by 1" in result.warnings
    assert result.sigma > valid_result_with_fixes.sigma
    assert result.is_within_3_sigma


@pytest.mark.parametrize("latitude", first_and_more(91.0, -1234.0))
def test_fixes_with_an_impossible_latitude_are_rejected_with_a_warning(
    folder, with_fixes, latitude, valid_result_with_fixes
):
    fixes = with_fixes.gnss
    half_impossible = np.where(np.arange(len(fixes)) < len(fixes) // 2, latitude, fixes["latitude_deg"])
    result = folder.fuse(replace(with_fixes, gnss=with_columns(fixes, latitude_deg=half_impossible)))
    assert "are not on Earth" in result.warnings
    assert result.sigma > valid_result_with_fixes.sigma
    assert result.is_within_3_sigma


def test_fixes_that_are_all_impossible_are_refused_in_one_line(folder, with_fixes):
    nowhere = np.full(len(with_fixes.gnss), 91.0)
    recording = replace(with_fixes, gnss=with_columns(with_fixes.gnss, latitude_deg=nowhere))
    assert "not on Earth" in folder.refusal(recording)


def test_a_single_fix_gives_only_the_position(folder, with_fixes, valid_result):
    one = Table({name: v[100:101] for name, v in with_fixes.gnss.columns.items()})
    result = folder.fuse(replace(with_fixes, gnss=one))
    assert "one fix only" in result.warnings
    assert result.sigma > valid_result.sigma
    assert result.is_within_3_sigma


def test_fixes_outside_the_time_of_the_odometry_are_refused_in_one_line(folder, with_fixes):
    late = with_columns(with_fixes.gnss, t=with_fixes.gnss.t + 1000.0)
    assert "outside the odometry" in folder.refusal(replace(with_fixes, gnss=late))


def test_a_clock_step_of_the_receiver_is_reported_and_sigma_increases(
    folder, with_fixes, valid_result_with_fixes
):
    fixes = with_fixes.gnss
    result = folder.fuse(replace(with_fixes, gnss=with_columns(fixes, t=fixes.t + 3.0 * (fixes.t > 20.0))))
    assert "sigmas were widened" in result.warnings
    assert result.sigma > 1.3 * valid_result_with_fixes.sigma
    assert result.is_within_3_sigma


@pytest.mark.parametrize(
    ("columns", "factor", "options"),
    [(("gx", "gy", "gz"), 180.0 / np.pi, "--unit deg/s"), (("ax", "ay", "az"), 1 / 9.80665, "--unit g")],
    ids=["degrees per second", "g"],
)
def test_samples_in_other_units_are_refused_and_converted_with_the_option_unit(
    folder, valid_result, valid_recording, columns, factor, options
):
    left = valid_recording.nodes["left"]
    scaled_left = with_columns(left, **{name: left[name] * factor for name in columns})
    right = valid_recording.nodes["right"]
    recording = replace(
        valid_recording,
        nodes={
            "left": scaled_left,
            "right": with_columns(right, **{name: right[name] * factor for name in columns}),
        },
    )
    assert options in folder.refusal(recording)
    converted = folder.fuse(recording, *options.split())
    assert converted.track["x"][-1] == pytest.approx(valid_result.track["x"][-1], abs=1e-3)
