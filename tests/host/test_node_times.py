"""Nodes whose times cannot be those of one drive are one clear line, at once: CSV folder and MCAP alike."""

import time
from dataclasses import replace

import numpy as np
import pytest

from generators.fake_drive import VEHICLE_TOML
from hubodo.log.csv_folder import write_folder
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from in_process import hubodo
from wheel_runs import short, tables

SEED, SECONDS = 5, 5.0


def timed(scale, apart):
    """A short drive with its truth: times in another unit, the right node's later by `apart`."""
    drive = short(SEED)
    nodes = {
        name: Table({**table.columns, "t": (table.t + apart * (name == "right")) * scale})
        for name, table in tables(drive).items()
    }
    truth = Table({"t": drive.t[::50] * scale, "x": drive.x[::50], "y": drive.y[::50]})
    return Recording(nodes, truth=truth)


@pytest.mark.parametrize("form", ["folder", "mcap"])
@pytest.mark.parametrize(
    ("scale", "apart", "words"),
    [
        (1e3, 0.0, "look like milliseconds: divide t by 1000"),
        (1e6, 0.0, "look like microseconds"),
        (1.0, 5000.0, "no time in common"),
        (1.0, 1e8, "no time in common"),
        (200.0, 0.0, "look like milliseconds"),
        (10.0, 0.0, "needs 12.5 samples a second"),
    ],
)
def test_times_that_cannot_be_are_refused_at_once(tmp_path, form, scale, apart, words):
    log, vehicle = tmp_path / "log", tmp_path / "vehicle.toml"
    recording = timed(scale, apart)
    if form == "folder":
        write_folder(recording, log)
    else:
        write_recording(recording, log := tmp_path / "log.mcap")
    vehicle.write_text(VEHICLE_TOML)
    for verb in (("fuse",), ("calibrate", "wheels"), ("report",)):
        begin = time.process_time()
        done = hubodo(*verb, log, "--vehicle", vehicle, "-o", tmp_path / "out")
        assert done.code == 2, (verb, done.out, done.err)
        assert done.err.count("\n") == 1 and words in done.err, done.err
        assert time.process_time() - begin < SECONDS
        assert not (tmp_path / "out").exists()


def test_a_folder_is_fused_as_the_log_made_of_it(tmp_path):
    folder, file, vehicle = tmp_path / "log", tmp_path / "log.mcap", tmp_path / "vehicle.toml"
    vehicle.write_text(VEHICLE_TOML)
    write_folder(timed(1.0, 0.0), folder)
    assert hubodo("import", folder, "-o", file).code == 0
    for log, out in ((folder, "a"), (file, "b")):
        done = hubodo("fuse", log, "--vehicle", vehicle, "-o", tmp_path / out)
        assert done.code == 0, done.err
    tracks = [(tmp_path / out / "track.csv").read_bytes() for out in "ab"]
    assert tracks[0] == tracks[1]
    for words in (("info",), ("play", "--speed", 0), ("export", "-o", tmp_path / "again")):
        done = hubodo(words[0], folder, *words[1:])
        assert done.code == 0, done.err
        assert str(folder) in done.out or words[0] == "export"


def test_a_rosbag2_folder_is_the_file_in_it_and_parts_are_one_log(tmp_path):
    bag, vehicle = tmp_path / "bag", tmp_path / "vehicle.toml"
    vehicle.write_text(VEHICLE_TOML)
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    fuse = ("fuse", bag, "--vehicle", vehicle, "-o", tmp_path / "out")
    assert "without an .mcap or .db3 file" in hubodo(*fuse).err
    write_recording(timed(1.0, 0.0), bag / "bag_0.mcap")
    assert hubodo(*fuse).code == 0
    write_recording(timed(1.0, 0.0), bag / "bag_1.mcap")
    done = hubodo(*fuse, "--force")
    assert (done.code, "repeat the time of another" in done.out) == (0, True), "both parts are the same here"


def test_a_node_that_is_not_fused_may_have_any_time(tmp_path):
    folder, vehicle = tmp_path / "log", tmp_path / "vehicle.toml"
    vehicle.write_text(VEHICLE_TOML)
    recording = timed(1.0, 5000.0)
    write_folder(replace(recording, truth=None), folder)
    done = hubodo("fuse", folder, "--vehicle", vehicle, "--nodes", "left", "-o", tmp_path / "out")
    assert done.code == 0, done.err
    assert np.loadtxt(tmp_path / "out" / "track.csv", delimiter=",", skiprows=1)[-1, 0] < 60.0
