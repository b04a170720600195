"""Implausible sample times are refused quickly and in one line, in CSV folders and in MCAP."""

import time
from dataclasses import replace

import numpy as np
import pytest

from generators.fake_drive import VEHICLE_TOML
from hubodo.log.csv_folder import write_folder
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from in_process import hubodo
from repetitions import first_and_more
from wheel_runs import short_loop, tables

SEED, SECONDS = 5, 5.0


def drive_with_times(scale, offset):
    """Return a short drive with its truth: times multiplied by `scale`, the right node `offset` s later."""
    drive = short_loop(SEED)
    nodes = {
        name: Table({**table.columns, "t": (table.t + offset * (name == "right")) * scale})
        for name, table in tables(drive).items()
    }
    truth = Table({"t": drive.t[::50] * scale, "x": drive.x[::50], "y": drive.y[::50]})
    return Recording(nodes, truth=truth)


@pytest.mark.parametrize("file_format", first_and_more("mcap", "folder"))
@pytest.mark.parametrize(
    ("scale", "offset", "message"),
    [
        (1e3, 0.0, "look like milliseconds: divide t by 1000"),
        (1e6, 0.0, "look like microseconds"),
        (1.0, 5000.0, "no time in common"),
        (1.0, 1e8, "no time in common"),
        (200.0, 0.0, "look like milliseconds"),
        (10.0, 0.0, "needs 12.5 samples a second"),
    ],
)
def test_implausible_times_are_refused_within_seconds(tmp_path, file_format, scale, offset, message):
    log, vehicle = tmp_path / "log", tmp_path / "vehicle.toml"
    recording = drive_with_times(scale, offset)
    if file_format == "folder":
        write_folder(recording, log)
    else:
        write_recording(recording, log := tmp_path / "log.mcap")
    vehicle.write_text(VEHICLE_TOML)
    for verb in (("fuse",), ("calibrate", "wheels"), ("report",)):
        start, out = time.process_time(), tmp_path / ("out" if verb == ("fuse",) else "out.html")
        done = hubodo(*verb, log, "--vehicle", vehicle, "-o", out)
        assert done.code == 2, (verb, done.out, done.err)
        assert done.err.count("\n") == 1 and message in done.err, done.err
        assert time.process_time() - start < SECONDS
        assert not out.exists()


def test_a_csv_folder_and_the_log_imported_from_it_give_the_same_track(tmp_path):
    folder, file, vehicle = tmp_path / "log", tmp_path / "log.mcap", tmp_path / "vehicle.toml"
    vehicle.write_text(VEHICLE_TOML)
    write_folder(drive_with_times(1.0, 0.0), folder)
    assert hubodo("import", folder, "-o", file).code == 0
    for log, out in ((folder, "a"), (file, "b")):
        done = hubodo("fuse", log, "--vehicle", vehicle, "-o", tmp_path / out)
        assert done.code == 0, done.err
    tracks = [(tmp_path / out / "track.csv").read_bytes() for out in "ab"]
    assert tracks[0] == tracks[1]
    for command in (("info",), ("play", "--speed", 0), ("export", "-o", tmp_path / "again")):
        done = hubodo(command[0], folder, *command[1:])
        assert done.code == 0, done.err
        assert str(folder) in done.out or command[0] == "export"


def test_a_rosbag2_folder_is_read_as_one_log_of_all_its_files(tmp_path):
    bag, vehicle = tmp_path / "bag", tmp_path / "vehicle.toml"
    vehicle.write_text(VEHICLE_TOML)
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    fuse = ("fuse", bag, "--vehicle", vehicle, "-o", tmp_path / "out")
    assert "without an .mcap or .db3 file" in hubodo(*fuse).err
    write_recording(drive_with_times(1.0, 0.0), bag / "bag_0.mcap")
    assert hubodo(*fuse).code == 0
    write_recording(drive_with_times(1.0, 0.0), bag / "bag_1.mcap")
    done = hubodo(*fuse, "--force")
    assert (done.code, "repeat the time of another" in done.out) == (0, True), "both parts are equal here"


def test_a_node_that_is_not_fused_may_have_any_time(tmp_path):
    folder, vehicle = tmp_path / "log", tmp_path / "vehicle.toml"
    vehicle.write_text(VEHICLE_TOML)
    recording = drive_with_times(1.0, 5000.0)
    write_folder(replace(recording, truth=None), folder)
    done = hubodo("fuse", folder, "--vehicle", vehicle, "--nodes", "left", "-o", tmp_path / "out")
    assert done.code == 0, done.err
    assert np.loadtxt(tmp_path / "out" / "track.csv", delimiter=",", skiprows=1)[-1, 0] < 60.0
