"""A recorder delayed by its own fusion or by the system loses no data that the line still buffers."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fakes.fake_node import FakeNode
from fakes.fake_slow_odometer import FakeSlowOdometer
from fakes.recorder_thread import RecorderThread
from generators.fake_drive import RADIUS, TRACK, VEHICLE_TOML, raw_rows, short_drive
from hubodo.ingest.live import recorder as recorder_module
from hubodo.log.recording_reader import read_recording
from hubodo.vehicle import NodeMount, Vehicle
from in_process import hubodo
from waiting import until

ROOT = Path(__file__).resolve().parents[4]
BOTH = Vehicle(RADIUS, TRACK, {name: NodeMount(name, "left") for name in ("left", "right")})
SEED, STALL_S = 5, 5.0
pytestmark = pytest.mark.real_time


def test_frames_are_recorded_without_loss_while_the_fusion_is_slow(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, "Odometer", FakeSlowOdometer)
    out = tmp_path / "a.mcap"
    with FakeNode() as node, RecorderThread(out, f"left={node.path}", vehicle=BOTH, duration=4.0) as running:
        running.thread.join(60)
    (node_result,) = running.result.as_json()["nodes"].values()
    assert (node_result["samples_lost"], node_result["gaps"]) == (0, {})
    assert node.dropped == 0
    # All except data in transit at the end, and data sent before the port was opened.
    assert len(read_recording(out).nodes["left"]) > 208 * 3.5


def held(out, vehicle, nodes, seconds, rows=None):
    """Record in a process that is stopped for STALL_S.

    Return its output and the number of frames that each node dropped meanwhile.
    """
    ports = [f"{name}={node.path}" for name, node in nodes.items()]
    words = ["record", *ports, "--duration", seconds, "-o", out, "--json", *vehicle]
    daemon = subprocess.Popen(
        [sys.executable, "-m", "hubodo.cli", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"},
    )
    until(lambda: all(node.requests for node in nodes.values()))
    # The drive begins when the port is opened; until then the nodes repeat its first rows.
    for name in rows or ():
        nodes[name].samples_created, nodes[name].rows = 0, rows[name]
    time.sleep(3.0)
    daemon.send_signal(signal.SIGSTOP)
    before = {name: node.dropped for name, node in nodes.items()}
    time.sleep(STALL_S)
    dropped = {name: node.dropped - before[name] for name, node in nodes.items()}
    daemon.send_signal(signal.SIGCONT)
    printed, errors = daemon.communicate(timeout=300)
    assert daemon.returncode == 0, errors
    return json.loads(printed), dropped


def test_a_stopped_recorder_gets_all_buffered_data_and_a_track_within_sigma(tmp_path):
    drive, out = short_drive(SEED), tmp_path / "a.mcap"
    rows = {name: raw_rows(drive, name) for name in ("left", "right")}
    (tmp_path / "vehicle.toml").write_text(VEHICLE_TOML)
    vehicle = ("--vehicle", tmp_path / "vehicle.toml")
    with (
        FakeNode(node_id=1, rows=rows["left"][:100]) as left,
        FakeNode(node_id=2, rows=rows["right"][:100]) as right,
    ):
        result, dropped = held(out, vehicle, {"left": left, "right": right}, 14.0, rows)
    for name, node in result["nodes"].items():
        print(
            f"{name}: {node['samples']} samples, {node['samples_lost']} lost, {dropped[name]} frames given up"
        )
        assert node["samples_lost"] <= 8 * dropped[name] + 8
    done = hubodo("fuse", out, *vehicle, "-o", tmp_path / "out", "--json")
    assert done.code == 0, done.err
    track = np.loadtxt(tmp_path / "out" / "track.csv", delimiter=",", skiprows=1)
    _, x, y, *_, sigma_x, sigma_y, _ = track[-1]
    off, sigma = np.hypot(x - drive.x[-1], y - drive.y[-1]), np.hypot(sigma_x, sigma_y)
    print(f"seed {SEED}: {off:.2f} m off at the end, 1 sigma {sigma:.2f} m")
    assert off < 3.0 * sigma + 0.05


def test_data_beyond_the_line_buffer_is_counted_as_a_gap(tmp_path):
    """At 1660 samples per second the line buffers less than five seconds."""
    out = tmp_path / "a.mcap"
    with FakeNode(rate_hz=1660.0) as node:
        result, dropped = held(out, (), {"left": node}, 12.0)
    (node_result,) = result["nodes"].values()
    print(f"{node_result['samples']} samples, {node_result['samples_lost']} lost, {dropped} frames given up")
    assert dropped["left"] > 100
    # On a busy computer the line also overflows before and after: the node's own time shows how often.
    assert node_result["samples_lost"] > 0.98 * 8 * dropped["left"]
    times = read_recording(out).nodes["left"].t
    assert len(times) == node_result["samples"]
    assert len(times) + node_result["samples_lost"] == pytest.approx(1 + np.ptp(times) * 1660.0, rel=0.02)
    missing = np.diff(times).max() * 1660.0
    assert missing > 0.5 * node_result["samples_lost"]
