"""A drive that is still being recorded: what is wrong is said once, and nothing of a sound vehicle."""

import io
import json
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from hubodo.cli import main
from hubodo.gap.watch import GapWatch
from hubodo.ingest.live.view import JsonView
from hubodo.log.any_log import read_log
from hubodo.recording import Table
from hubodo.vehicle import load_vehicle
from hubodo.verbs import watch_gap
from hubodo.verbs.watch_gap import newest_log, run_gap_watch
from vehicles import vehicle_toml

VEHICLE = vehicle_toml()
NOISE = "[imu]\ngyro_noise = 0.004\naccel_noise = 0.05\n"
ARM = "[nodes.left.effects.lever_arm]\nx = 0.12\ny = 0.09\n"


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Folder with arm.mcap, sound.mcap, vehicle.toml: 40 s each, one with the IMU 0.15 m off the hub."""
    folder = tmp_path_factory.mktemp("watch")
    (folder / "vehicle.toml").write_text(VEHICLE, "utf-8")
    for name, hidden in (("arm", ARM), ("sound", "")):
        (folder / f"{name}.toml").write_text(VEHICLE + NOISE + hidden, "utf-8")
        words = ["--duration", "40", "--rate", "52", "--seed", "3", "-o", str(folder / f"{name}.mcap")]
        with redirect_stdout(io.StringIO()):
            assert main(["simulate", str(folder / f"{name}.toml"), *words]) == 0
    return folder


def grown(log, seconds):
    """The log as it was after so many seconds."""
    read = read_log(log)
    nodes = {}
    for name, table in read.nodes.items():
        kept = table.t < table.t[0] + seconds
        nodes[name] = Table({column: table[column][kept] for column in table})
    return replace(read, nodes=nodes)


def test_a_sensor_off_the_hub_is_said_within_the_minute_and_once(drives):
    watch = GapWatch(load_vehicle(drives / "vehicle.toml"))
    said = [watch.find_new_effects(grown(drives / "arm.mcap", seconds)) for seconds in (20.5, 32.0, 38.0)]
    assert said == [[], ["left: the IMU sits 0.15 m off the hub"], []]


def test_of_a_sound_vehicle_nothing_is_said(drives):
    watch = GapWatch(load_vehicle(drives / "vehicle.toml"))
    assert watch.find_new_effects(grown(drives / "sound.mcap", 36.0)) == []


def first_finding(drives):
    """The first event of the process beside a recording."""
    second, events = SimpleNamespace(t_ns=1_000_000_000), []
    with run_gap_watch(True, drives / "arm.mcap", drives / "vehicle.toml") as watch:
        end = time.monotonic() + 500.0
        while not events and time.monotonic() < end:
            time.sleep(0.1)
            events += watch["gap"](second)
    return events[0]


@pytest.mark.real_time
def test_the_process_beside_a_recording_finds_it_and_ends_with_it(drives):
    event = first_finding(drives)
    assert (event.kind, event.text) == ("gap_seen", "left: the IMU sits 0.15 m off the hub")


@pytest.mark.real_time
def test_a_finding_is_a_warning_for_programs(drives, monkeypatch):
    """Of any process that prints a line."""
    start = subprocess.Popen
    speaker = [sys.executable, "-c", "print('left: askew', flush=True); input()"]
    monkeypatch.setattr(watch_gap.subprocess, "Popen", lambda command, **options: start(speaker, **options))
    out = io.StringIO()
    JsonView(out, lambda: 0, quiet=False).show_notice(first_finding(drives))
    line = json.loads(out.getvalue())
    assert (line["level"], line["event"], line["text"]) == ("warning", "gap_seen", "left: askew")


def test_the_log_that_is_being_written_is_found(tmp_path):
    assert newest_log(tmp_path / "ride.mcap") is None
    for name in ("ride-1.mcap", "ride-2.mcap", "other.mcap"):
        (tmp_path / name).write_bytes(b"")
        time.sleep(0.02)
    assert newest_log(tmp_path / "ride.mcap") == tmp_path / "ride-2.mcap"
    assert newest_log(tmp_path) == tmp_path / "other.mcap"
    assert newest_log(tmp_path / "ride-1.mcap") == tmp_path / "ride-1.mcap"


def test_watching_wants_the_geometry(tmp_path):
    err = io.StringIO()
    with redirect_stderr(err):
        code = main(["record", "/dev/null", "--watch-gap", "-o", str(Path(tmp_path) / "ride.mcap")])
    assert code == 2
    assert "--vehicle" in err.getvalue()
