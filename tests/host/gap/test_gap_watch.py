"""`hubodo record --watch-gap`: an effect is reported once, and none for a faultless vehicle."""

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
HIDDEN_LEVER_ARM = "[nodes.left.effects.lever_arm]\nx = 0.04\ny = 0.03\n"


@pytest.fixture(scope="module")
def drive_logs(tmp_path_factory):
    """Return a folder with vehicle.toml, arm.mcap (IMU 0.05 m off the hub) and sound.mcap, 30 s each."""
    folder = tmp_path_factory.mktemp("watch")
    (folder / "vehicle.toml").write_text(VEHICLE, "utf-8")
    for name, hidden in (("arm", HIDDEN_LEVER_ARM), ("sound", "")):
        (folder / f"{name}.toml").write_text(VEHICLE + NOISE + hidden, "utf-8")
        options = ["--duration", "30", "--rate", "26", "--seed", "3", "-o", str(folder / f"{name}.mcap")]
        with redirect_stdout(io.StringIO()):
            assert main(["simulate", str(folder / f"{name}.toml"), *options]) == 0
    return folder


def read_first_seconds(log, seconds):
    """Return the first `seconds` of a log, as it was during the recording."""
    log_contents = read_log(log)
    nodes = {}
    for name, table in log_contents.nodes.items():
        is_recorded = table.t < table.t[0] + seconds
        nodes[name] = Table({column: table[column][is_recorded] for column in table})
    return replace(log_contents, nodes=nodes)


def test_a_lever_arm_is_reported_once_and_within_a_minute(drive_logs):
    watch = GapWatch(load_vehicle(drive_logs / "vehicle.toml"))
    messages = [
        watch.find_new_effects(read_first_seconds(drive_logs / "arm.mcap", seconds))
        for seconds in (20.5, 23.0, 28.0)
    ]
    assert messages == [[], ["left: the IMU sits 0.05 m off the hub"], []]


def test_nothing_is_reported_for_a_vehicle_without_effects(drive_logs):
    watch = GapWatch(load_vehicle(drive_logs / "vehicle.toml"))
    assert watch.find_new_effects(read_first_seconds(drive_logs / "sound.mcap", 28.0)) == []


def wait_for_first_finding(drive_logs):
    """Return the first event of the watch process beside a recording."""
    snapshot, events = SimpleNamespace(t_ns=1_000_000_000), []
    with run_gap_watch(True, drive_logs / "arm.mcap", drive_logs / "vehicle.toml") as watch:
        end = time.monotonic() + 500.0
        while not events and time.monotonic() < end:
            time.sleep(0.1)
            events += watch["gap"](snapshot)
    return events[0]


@pytest.mark.real_time
def test_the_watch_process_reports_the_lever_arm_and_ends_with_the_recording(drive_logs):
    event = wait_for_first_finding(drive_logs)
    assert (event.kind, event.text) == ("gap_seen", "left: the IMU sits 0.05 m off the hub")


@pytest.mark.real_time
def test_a_finding_is_a_warning_in_the_json_output(drive_logs, monkeypatch):
    """The watch process is replaced by one that prints a line."""
    start_process = subprocess.Popen
    printing_process = [sys.executable, "-c", "print('left: askew', flush=True); input()"]
    monkeypatch.setattr(
        watch_gap.subprocess, "Popen", lambda command, **options: start_process(printing_process, **options)
    )
    out = io.StringIO()
    JsonView(out, lambda: 0, quiet=False).show_notice(wait_for_first_finding(drive_logs))
    line = json.loads(out.getvalue())
    assert (line["level"], line["event"], line["text"]) == ("warning", "gap_seen", "left: askew")


def test_the_newest_log_is_watched(tmp_path):
    assert newest_log(tmp_path / "ride.mcap") is None
    for name in ("ride-1.mcap", "ride-2.mcap", "other.mcap"):
        (tmp_path / name).write_bytes(b"")
        time.sleep(0.02)
    assert newest_log(tmp_path / "ride.mcap") == tmp_path / "ride-2.mcap"
    assert newest_log(tmp_path) == tmp_path / "other.mcap"
    assert newest_log(tmp_path / "ride-1.mcap") == tmp_path / "ride-1.mcap"


def test_watching_without_a_vehicle_file_is_refused(tmp_path):
    err = io.StringIO()
    with redirect_stderr(err):
        code = main(["record", "/dev/null", "--watch-gap", "-o", str(Path(tmp_path) / "ride.mcap")])
    assert code == 2
    assert "--vehicle" in err.getvalue()
