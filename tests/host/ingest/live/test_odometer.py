"""Odometry while recording: accuracy, latency, rate, and equality with playback bit by bit."""

import json

import numpy as np
import pytest

from fakes.fake_node import FakeNode
from fakes.script import Script
from generators.fake_drive import RADIUS, TRACK, VEHICLE_TOML, raw_rows, short_drive
from generators.wheel_drives import GYRO_STEP
from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    NodeCalibration,
    Quantity,
    format_calibration,
    parse_calibration,
)
from hubodo.errors import CalibrationError, InputError
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.latency import LatencyHistogram
from hubodo.ingest.live.odometer import Odometer
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.ingest.replay.playback import Playback, recorded_messages, to_messages
from hubodo.log import topics
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.records import ImuBlock
from hubodo.vehicle import NodeMount, Vehicle
from in_process import hubodo

SEED = 5
TWO_WHEELS = Vehicle(RADIUS, TRACK, {name: NodeMount(name, "left") for name in ("left", "right")})
CALIBRATION = Calibration(
    {
        "left": NodeCalibration(
            {
                "gyro_bias": CalibratedEffect({"x": Quantity(0.02, 0.05), "z": Quantity(0.01, 0.05)}),
                "gyro_warmup": CalibratedEffect(
                    {"z": Quantity(0.001, 1e-3), "time_constant": Quantity(60.0, 6.0)}
                ),
                "gyro_temperature": CalibratedEffect({"z": Quantity(1e-4, 1e-5)}),
            },
            b"FAKE0001".hex(),
        )
    }
)


@pytest.fixture(scope="module")
def ride(tmp_path_factory):
    """Record eleven seconds with a calibration: (log, JSON result, drive).

    The right node is unplugged for 0.15 s at 7 s, the left one restarts at 9.65 s.
    """
    folder = tmp_path_factory.mktemp("ride")
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    (folder / "calibration.toml").write_text(format_calibration(CALIBRATION))
    drive, out = short_drive(SEED), folder / "ride.mcap"
    ports = {name: folder / name for name in ("left", "right")}
    computer = VirtualComputer()
    faults = ((7.0, lambda: right.unplug()), (7.15, lambda: right.plug()), (9.65, lambda: left.reset()))
    Script(computer, *faults)
    with (
        FakeNode(node_id=1, link=ports["left"], rows=raw_rows(drive, "left"), computer=computer) as left,
        FakeNode(node_id=2, link=ports["right"], rows=raw_rows(drive, "right"), computer=computer) as right,
    ):
        done = hubodo(
            "record", *(f"{name}={port}" for name, port in ports.items()),
            "--vehicle", folder / "vehicle.toml",
            "--calibration", folder / "calibration.toml", "--duration", 11, "-o", out, "--json",
            computer=computer,
        )  # fmt: skip
    assert done.code == 0, done.err
    return out, json.loads(done.out), drive


def test_the_live_odometry_follows_the_drive(ride):
    _, result, drive = ride
    odometry = result["odometry"]
    assert odometry["nodes"] == ["left", "right"]
    assert odometry["distance"] == pytest.approx(drive.length, rel=0.03), f"seed {SEED}"
    error = np.hypot(odometry["x"] - drive.x[-1], odometry["y"] - drive.y[-1])
    # The samples of the unplugged wheel are lost for 0.15 s.
    assert error < 0.05 * drive.length, f"seed {SEED}: {error} m"


def test_odometry_comes_at_the_rate_of_the_nodes_within_20_ms_of_the_frame(ride):
    out, result, _ = ride
    t = read_recording(out).odometry.t
    undisturbed = t[t < t[0] + 4.0]
    assert (len(undisturbed) - 1) / (undisturbed[-1] - undisturbed[0]) == pytest.approx(208.0, rel=0.01)
    assert len(t) == result["odometry"]["poses"]
    odometry = result["odometry"]
    assert 0 < odometry["latency_median"] < odometry["latency_p99"] <= odometry["latency_worst"] < 0.02


def test_the_poses_of_a_frame_are_published_before_the_next_frame_is_read(ride):
    out, _, _ = ride
    newest, delays = {topics.ODOM: 0, "imu": 0}, []
    with open_log(out) as log:
        for messages in log.chunks():
            columns = (messages.headers[key].tolist() for key in ("channel", "publish_time"))
            for channel, t_ns in zip(*columns, strict=True):
                topic = log.streams[channel].topic
                if topic.startswith(topics.RAW_PREFIX) and newest[topics.ODOM]:
                    delays.append((newest["imu"] - newest[topics.ODOM]) * 1e-9)
                kind = "imu" if topic.endswith("/imu") else topic
                if kind in newest:
                    newest[kind] = max(newest[kind], t_ns)
    # A sample less than half a period after the previous one gets no pose.
    assert len(delays) > 400
    assert max(delays) < 0.5 / 208.0


def test_playback_reproduces_the_recorded_odometry_bit_by_bit(ride):
    """The log contains a disconnection and a restart, after which samples wait for the clock estimate."""
    out, _, _ = ride
    playback = Playback(out)
    assert to_messages(playback.odometry_rows(), playback.t_zero_ns) == recorded_messages(out)
    odometry = json.loads(hubodo("play", out, "--speed", 0, "--json").out)["odometry"]
    assert odometry["equal"] is True
    assert odometry["poses"] == odometry["recorded"] > 1500


def test_raw_samples_and_the_calibration_are_both_in_the_log(ride):
    out, _, drive = ride
    with open_log(out) as log:
        attachments = log.attachments
    assert parse_calibration(attachments["calibration.toml"].decode(), out) == CALIBRATION
    assert attachments["vehicle.toml"].decode() == VEHICLE_TOML
    steps = np.round(read_recording(out).nodes["left"]["gz"] / GYRO_STEP)
    rows = np.array(raw_rows(drive, "left"))[:, 2]
    first = next(k for k in range(len(rows)) if (steps[:200] == rows[k : k + 200]).all())
    np.testing.assert_array_equal(steps[:1000], rows[first : first + 1000])


def test_another_calibration_in_playback_gives_another_track(ride):
    out, _, _ = ride
    scale = CalibratedEffect({"z": Quantity(0.05, 1e-4)})
    other = Calibration({"left": NodeCalibration({"gyro_scale_factor": scale})})
    playback = Playback(out, calibration=other)
    assert to_messages(playback.odometry_rows(), playback.t_zero_ns) != recorded_messages(out)
    with pytest.raises(CalibrationError, match="bb02"):
        Playback(
            out, calibration=Calibration({"left": NodeCalibration({"gyro_scale_factor": scale}, "bb02")})
        )


def test_the_start_of_a_node_is_an_event_from_which_its_age_is_known(ride):
    out, _, _ = ride
    recording = read_recording(out)
    starts = [event for event in recording.events if event.kind == "started" and event.source == "left"]
    assert len(starts) == 2
    # The clock of a fake node starts with the fake; without power loss the chip stays warm.
    assert 0.0 <= starts[0].data["age"] < 5.0
    assert starts[1].data["power_on_ns"] == starts[0].data["power_on_ns"]


def test_one_wheel_is_sufficient_and_a_warning_of_the_filter_becomes_an_event(tmp_path):
    """The vehicle file has the node facing right; in fact it faces left."""
    wrong = Vehicle(RADIUS, TRACK, {"left": NodeMount("left", "right"), "right": NodeMount("right", "left")})
    out, computer = tmp_path / "a.mcap", VirtualComputer()
    with FakeNode(node_id=1, rows=raw_rows(short_drive(SEED), "left"), computer=computer) as node:
        config = RecordConfig(ports=(node.path,), duration=7.0)
        result = record(config, out, vehicle=wrong, computer=computer)
    assert result.odometry["nodes"] == ["left"]
    assert result.odometry["poses"] > 500
    texts = [event.text for event in read_recording(out).events if event.kind == "warning"]
    assert any("rolled backwards" in text for text in texts), texts


def test_the_calibration_of_another_node_ends_the_recording_and_leaves_nothing_behind(tmp_path):
    wrong = Calibration({"left": NodeCalibration({}, "bb02")})
    out, computer = tmp_path / "a.mcap", VirtualComputer()
    with (
        FakeNode(node_id=1, computer=computer) as node,
        pytest.raises(CalibrationError, match=b"FAKE0001".hex()),
    ):
        config = RecordConfig(ports=(node.path,), duration=5.0)
        record(config, out, vehicle=TWO_WHEELS, calibration=wrong, computer=computer)
    assert not out.exists()


def blocks(seed, names=("left", "right"), size=8, start_delay=0.0):
    """Return the blocks of a drive by time; the right wheel starts `late` s after the left one."""
    timed_blocks = []
    for name, node in short_drive(seed, 104.0).nodes.items():
        if name in names:
            t_ns = np.round(node.t * 1e9).astype(np.int64)
            sent = np.flatnonzero(t_ns >= (int(start_delay * 1e9) if name == "right" else 0))
            for k in range(0, len(sent), size):
                rows = sent[k : k + size]
                block = ImuBlock(name, node.gyro[rows], node.accel[rows], None, 0, t_ns=t_ns[rows])
                timed_blocks.append((int(t_ns[rows[-1]]), block))
    return [block for _, block in sorted(timed_blocks, key=lambda item: item[0])]


def test_a_wheel_that_starts_late_is_named_and_the_other_one_is_used():
    odometer = Odometer(TWO_WHEELS, 0)
    for block in blocks(3, start_delay=5.0):
        odometer.handle(block)
    odometer.finish()
    assert odometer.nodes == ("left",)
    assert any("right: first samples" in line for line in odometer.warnings(end=True))
    assert odometer.warnings(end=True) == []


@pytest.mark.parametrize("mirrored", [(), ("left",), ("left", "right")])
def test_mirrored_axes_of_a_node_are_named_while_driving(mirrored):
    """Live they are named but not corrected: x and y are exchanged in the nodes listed."""
    odometer, exchange = Odometer(TWO_WHEELS, 0), [1, 0, 2]
    for block in blocks(3):
        if block.node in mirrored:
            gyro, accel = block.gyro[:, exchange], block.accel[:, exchange]
            block = ImuBlock(block.node, gyro, accel, None, 0, t_ns=block.t_ns)
        odometer.handle(block)
    odometer.finish()
    named = [line for line in odometer.warnings(end=True) if "an axis is mirrored" in line]
    assert sorted(line.split(":")[0] for line in named) == list(mirrored)


def test_the_rate_of_the_odometry_can_be_reduced():
    full_rate, reduced_rate = Odometer(TWO_WHEELS, 0), Odometer(TWO_WHEELS, 0, rate_hz=20.0)
    for block in blocks(3):
        full_rate.handle(block)
        reduced_rate.handle(block)
    assert full_rate.distance == reduced_rate.distance
    assert full_rate.pose_count == pytest.approx(104 * 11, rel=0.15)
    assert reduced_rate.pose_count == pytest.approx(20 * 10, rel=0.2)


def test_a_vehicle_without_a_wheel_node_is_refused():
    with pytest.raises(InputError, match="side and a facing"):
        Odometer(Vehicle(RADIUS, TRACK, {"frame": NodeMount()}), 0)


def test_latency_quantiles_are_never_below_the_true_quantiles():
    rng = np.random.default_rng(8)
    values = rng.lognormal(14.0, 1.5, 5000).astype(int)
    latency = LatencyHistogram()
    assert latency.as_json()["latency_p99"] is None
    for value in values.tolist():
        latency.add(value)
    assert latency.maximum == values.max() / 1e9
    for share in (0.5, 0.99):
        true_quantile = np.sort(values)[int(np.ceil(share * len(values))) - 1] / 1e9
        assert true_quantile <= latency.quantile(share)
        assert latency.quantile(share) <= max(true_quantile + 20e-6, 0.0) or true_quantile > 0.1
