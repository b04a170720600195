"""Recordings of topics that another process publishes with Cyclone DDS and types written by hand."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import wanted
from generators.fake_drive import VEHICLE_TOML, short_drive
from hubodo.ingest.live.odometer import Odometer
from hubodo.ingest.replay.playback import Playback, recorded_messages, to_messages
from hubodo.log.recording_reader import read_recording
from in_process import hubodo

wanted.module("cyclonedds")
FAKES = Path(__file__).resolve().parents[3] / "fakes"
DOMAIN = 1 + os.getpid() % 99
RATE_HZ = 100.0

pytestmark = pytest.mark.real_time


@pytest.fixture
def domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))


def record_while_publishing(folder, plan, *words):
    """Record while another process publishes a plan; return the result of the verb."""
    (folder / "plan.json").write_text(json.dumps(plan))
    command = [sys.executable, str(FAKES / "ros2_publisher.py"), str(DOMAIN), str(folder / "plan.json")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        done = hubodo("record", *words, "-o", folder / "ride.mcap", "--quiet", "--json")
        process.kill()
    return done


def samples_of(drive, seconds):
    """Return the plan of two topics with the samples of a drive."""
    plan = []
    for name, table in drive.nodes.items():
        table.accel[:, 0] += 1e-9 * np.arange(len(table.t))  # all samples differ, also at standstill
        for t, gyro, accel in zip(table.t.tolist(), table.gyro.tolist(), table.accel.tolist(), strict=True):
            if t < seconds:
                values = {"gyro": gyro, "accel": accel, "variances": [1e-4, 0.01]}
                plan.append([t, f"/{name}_wheel/imu", "imu", values])
    return sorted(plan, key=lambda row: row[0])


def test_topics_of_two_nodes_and_an_encoder_become_a_log_and_a_track(tmp_path, domain):
    (tmp_path / "vehicle.toml").write_text(VEHICLE_TOML)
    drive = short_drive(5, rate_hz=RATE_HZ)
    speed = np.interp(np.arange(0.0, 4.5, 0.02), drive.t, drive.speed) / drive.radius
    joints = [
        [0.02 * n, "/joints", "joints", {"names": ["l_wheel", "r_wheel"], "velocity": [rate, rate]}]
        for n, rate in enumerate(speed.tolist())
    ]
    plan = sorted([*samples_of(drive, 4.5), *joints], key=lambda row: row[0])
    ports = ("ros2:/left_wheel/imu", "ros2:/right_wheel/imu", "wheels=ros2:/joints")
    ports = (*ports, "--vehicle", tmp_path / "vehicle.toml")
    done = record_while_publishing(tmp_path, plan, *ports, "--duration", 6)
    assert done.code == 0, done.err
    result = json.loads(done.out)
    log = read_recording(tmp_path / "ride.mcap")
    for name in ("left", "right"):
        node, truth = result["nodes"][name], drive.nodes[name]
        # Best effort: a busy computer loses messages, but none is altered and each loss is a gap.
        assert 200 < node["samples"] == len(log.nodes[name].t)
        sent = {tuple(row): n for n, row in enumerate(np.hstack([truth.gyro, truth.accel]).tolist())}
        logged = np.hstack([log.nodes[name].gyro, log.nodes[name].accel]).tolist()
        rows = [sent[tuple(row)] for row in logged]
        np.testing.assert_allclose(np.diff(log.nodes[name].t), np.diff(truth.t[rows]), atol=2e-5)
        assert result["links"][name]["frames_damaged"] == 0
    assert result["odometry"]["nodes"] == ["left", "right"] and result["odometry"]["poses"] > 100
    assert len(log.wheels.t) > 100
    # The odometry has used the speeds: without them playback gives other poses.
    played = to_messages(Playback(tmp_path / "ride.mcap").publications(), log.t_zero_ns)
    assert played == recorded_messages(tmp_path / "ride.mcap")
    unaided = Playback(tmp_path / "ride.mcap")
    unaided.odometer = Odometer(unaided.vehicle, log.t_zero_ns)
    assert to_messages(unaided.publications(), log.t_zero_ns) != played


def test_topics_that_cannot_be_recorded_are_refused_in_one_line(tmp_path, domain):
    fix = {"latitude": 47.0, "longitude": 8.0, "sigma": 1.0}
    (tmp_path / "plan.json").write_text(json.dumps([[60.0, "/fix", "fix", fix]]))
    command = [sys.executable, str(FAKES / "ros2_publisher.py"), str(DOMAIN), str(tmp_path / "plan.json")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        for port, advice in (("ros2:/fix", "write --gnss ros2:/fix"), ("ros2:/imu", "nobody publishes it")):
            done = hubodo("record", port, "-o", tmp_path / "ride.mcap", "--duration", 1)
            assert done.code == 2 and advice in done.err and len(done.err.splitlines()) == 1
            assert not (tmp_path / "ride.mcap").exists()
        process.kill()
