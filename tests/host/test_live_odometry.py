"""Odometry while recording: right, in time, at the rate of the nodes, and the same bits in playback."""

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
BOTH = Vehicle(RADIUS, TRACK, {name: NodeMount(name, "left") for name in ("left", "right")})
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
    """Eleven seconds recorded by the command, calibrated: (log, JSON result, drive).

    One node is unplugged on the way, the other restarted at the end.
    """
    folder = tmp_path_factory.mktemp("ride")
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    (folder / "calibration.toml").write_text(format_calibration(CALIBRATION))
    made, out = short_drive(SEED), folder / "ride.mcap"
    ends = {name: folder / name for name in ("left", "right")}
    computer = VirtualComputer()
    trouble = ((7.0, lambda: right.unplug()), (7.15, lambda: right.plug()), (9.65, lambda: left.reset()))
    Script(computer, *trouble)
    with (
        FakeNode(node_id=1, link=ends["left"], rows=raw_rows(made, "left"), computer=computer) as left,
        FakeNode(node_id=2, link=ends["right"], rows=raw_rows(made, "right"), computer=computer) as right,
    ):
        done = hubodo(
            "record", *(f"{name}={end}" for name, end in ends.items()), "--vehicle", folder / "vehicle.toml",
            "--calibration", folder / "calibration.toml", "--duration", 11, "-o", out, "--json",
            computer=computer,
        )  # fmt: skip
    assert done.code == 0, done.err
    return out, json.loads(done.out), made


def test_the_live_odometry_follows_the_drive(ride):
    _, result, made = ride
    found = result["odometry"]
    assert found["nodes"] == ["left", "right"]
    assert found["distance"] == pytest.approx(made.length, rel=0.03), f"seed {SEED}"
    off = np.hypot(found["x"] - made.x[-1], found["y"] - made.y[-1])
    # The unplugged wheel's samples are gone for 0.15 s.
    assert off < 0.05 * made.length, f"seed {SEED}: {off} m"


def test_odometry_comes_at_the_rate_of_the_nodes_within_20_ms_of_the_frame(ride):
    out, result, _ = ride
    t = read_recording(out).odometry.t
    smooth = t[t < t[0] + 4.0]
    assert (len(smooth) - 1) / (smooth[-1] - smooth[0]) == pytest.approx(208.0, rel=0.01)
    assert len(t) == result["odometry"]["poses"]
    found = result["odometry"]
    assert 0 < found["latency_median"] < found["latency_p99"] <= found["latency_worst"] < 0.02


def test_the_poses_of_a_frame_are_published_before_the_next_frame_is_looked_at(ride):
    out, _, _ = ride
    newest, behind = {topics.ODOM: 0, "imu": 0}, []
    with open_log(out) as log:
        for messages in log.chunks():
            columns = (messages.headers[key].tolist() for key in ("channel", "publish_time"))
            for channel, t_ns in zip(*columns, strict=True):
                topic = log.streams[channel].topic
                if topic.startswith(topics.RAW_PREFIX) and newest[topics.ODOM]:
                    behind.append((newest["imu"] - newest[topics.ODOM]) * 1e-9)
                kind = "imu" if topic.endswith("/imu") else topic
                if kind in newest:
                    newest[kind] = max(newest[kind], t_ns)
    # No pose for a sample that is less than half a period away from the one before.
    assert len(behind) > 400
    assert max(behind) < 0.5 / 208.0


def test_the_log_alone_gives_the_recorded_odometry_again_to_the_last_bit(ride):
    """With an unplugged node and a restarted one, whose samples are held back for the clock, in it."""
    out, _, _ = ride
    playback = Playback(out)
    assert to_messages(playback.odometry_rows(), playback.t_zero_ns) == recorded_messages(out)
    odometry = json.loads(hubodo("play", out, "--speed", 0, "--json").out)["odometry"]
    assert odometry["equal"] is True
    assert odometry["poses"] == odometry["recorded"] > 1500


def test_raw_samples_and_the_calibration_are_both_in_the_log(ride):
    out, _, made = ride
    with open_log(out) as log:
        kept = log.attachments
    assert parse_calibration(kept["calibration.toml"].decode(), out) == CALIBRATION
    assert kept["vehicle.toml"].decode() == VEHICLE_TOML
    steps = np.round(read_recording(out).nodes["left"]["gz"] / GYRO_STEP)
    rows = np.array(raw_rows(made, "left"))[:, 2]
    begin = next(k for k in range(len(rows)) if (steps[:200] == rows[k : k + 200]).all())
    np.testing.assert_array_equal(steps[:1000], rows[begin : begin + 1000])


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
    # The fake's clock starts with the fake; a restart without loss of power leaves the chip warm.
    assert 0.0 <= starts[0].data["age"] < 5.0
    assert starts[1].data["power_on_ns"] == starts[0].data["power_on_ns"]


def test_one_wheel_is_enough_and_a_warning_of_the_filter_becomes_an_event(tmp_path):
    """The node faces the other way than the vehicle file says."""
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
        record(config, out, vehicle=BOTH, calibration=wrong, computer=computer)
    assert not out.exists()


def blocks(seed, names=("left", "right"), size=8, late=0.0):
    """Blocks of a drive by time; `late`: s by which the second wheel is first heard after the first."""
    found = []
    for name, node in short_drive(seed, 104.0).nodes.items():
        if name in names:
            t_ns = np.round(node.t * 1e9).astype(np.int64)
            keep = np.flatnonzero(t_ns >= (int(late * 1e9) if name == "right" else 0))
            for k in range(0, len(keep), size):
                rows = keep[k : k + size]
                block = ImuBlock(name, node.gyro[rows], node.accel[rows], None, 0, t_ns=t_ns[rows])
                found.append((int(t_ns[rows[-1]]), block))
    return [block for _, block in sorted(found, key=lambda item: item[0])]


def test_a_wheel_that_is_heard_late_is_named_and_the_other_one_carries_on():
    odometer = Odometer(BOTH, 0)
    for block in blocks(3, late=5.0):
        odometer.handle(block)
    odometer.finish()
    assert odometer.nodes == ("left",)
    assert any("right: first samples" in line for line in odometer.warnings(end=True))
    assert odometer.warnings(end=True) == []


def test_odometry_can_be_asked_for_at_a_lower_rate():
    whole, thin = Odometer(BOTH, 0), Odometer(BOTH, 0, rate_hz=20.0)
    for block in blocks(3):
        whole.handle(block)
        thin.handle(block)
    assert whole.distance == thin.distance
    assert whole.pose_count == pytest.approx(104 * 11, rel=0.15)
    assert thin.pose_count == pytest.approx(20 * 10, rel=0.2)


def test_a_vehicle_without_a_wheel_node_is_refused():
    with pytest.raises(InputError, match="side and a facing"):
        Odometer(Vehicle(RADIUS, TRACK, {"frame": NodeMount()}), 0)


def test_latency_quantiles_are_never_below_the_truth():
    rng = np.random.default_rng(8)
    values = rng.lognormal(14.0, 1.5, 5000).astype(int)
    latency = LatencyHistogram()
    assert latency.as_json()["latency_p99"] is None
    for value in values.tolist():
        latency.add(value)
    assert latency.maximum == values.max() / 1e9
    for share in (0.5, 0.99):
        true = np.sort(values)[int(np.ceil(share * len(values))) - 1] / 1e9
        assert true <= latency.quantile(share)
        assert latency.quantile(share) <= max(true + 20e-6, 0.0) or true > 0.1
