"""Logs for other programs: rosbags-convert converts them in both directions, tf has the node poses."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from hubodo.log import topics
from hubodo.log.any_log import read_log
from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Event, Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from in_process import hubodo

VEHICLE = Vehicle(
    0.3,
    0.9,
    {"left": NodeMount("left", "left"), "right": NodeMount("right", "right"), "frame": NodeMount()},
    antenna=(0.5, 0.1),
)
T0 = 1_700_000_000_000_000_000
FRAMES = [b"", b"\x01\x02\x00", bytes(range(250))]
RNG = np.random.default_rng(8)
T = np.arange(200) / 100


def full_recording() -> Recording:
    """Return two nodes, reference, fixes, truth with headings, and an event."""
    node = {name: RNG.normal(size=200) for name in ("gx", "gy", "gz", "ax", "ay", "az")}
    heading = np.unwrap(RNG.normal(0.0, 0.2, 200)) + 3.0
    return Recording(
        {"left": Table({"t": T, **node}), "right": Table({"t": T, **node})},
        reference=Table({"t": T, "speed": RNG.normal(size=200), "yaw_rate": RNG.normal(size=200)}),
        truth=Table({"t": T, "x": RNG.normal(size=200), "y": RNG.normal(size=200), "heading": heading}),
        events=(Event(T0 + 5, "gap", "left", "lost ü", {"samples_lost": 3}),),
        t_zero_ns=T0,
    )


@pytest.fixture(scope="module")
def recording() -> Recording:
    return full_recording()


@pytest.fixture(scope="module")
def log(recording, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("ours") / "ours.mcap"
    write_recording(recording, path, vehicle=VEHICLE)
    return path


def assert_same(read: Recording, recording: Recording) -> None:
    for name, table in recording.files().items():
        assert list(read.files()[name]) == list(table)
        for column in table:
            np.testing.assert_allclose(read.files()[name][column], table[column], rtol=0, atol=1e-12)
    assert read.events == recording.events
    assert read.t_zero_ns == T0
    assert read.warnings == ()


@pytest.mark.parametrize("name", ["db3", "again.mcap", "ros1.bag"])
def test_rosbags_convert_preserves_the_log(name, log, recording, tmp_path):
    form = ["--dst-storage", "mcap"] if name.endswith(".mcap") else []
    words = ["-m", "rosbags.convert", "--src", str(log), "--dst", str(tmp_path / name), *form]
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert_same(read_log(tmp_path / name), recording)


def test_an_exported_rosbag2_has_the_same_messages_and_latched_static_frames(log, recording, tmp_path):
    done = hubodo("export", log, "--format", "rosbag2", "-o", tmp_path / "bag")
    assert done.code == 0, done.err
    assert_same(read_log(tmp_path / "bag"), recording)
    with AnyReader([tmp_path / "bag"]) as reader, open_log(log) as ours:
        (static,) = (it for it in reader.connections if it.topic == topics.TF_STATIC)
        assert static.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
        theirs = sorted((t, it.topic, raw) for it, t, raw in reader.messages())
        assert theirs == sorted((m.log_time, m.topic, m.data) for m in ours.messages())
    done = hubodo("export", log, "--format", "rosbag2", "-o", tmp_path / "bag")
    assert (done.code, "exists already" in done.err) == (2, True)


def test_tf_static_has_the_poses_of_the_nodes(log):
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        ((*_, message),) = reader.iter_decoded_messages(topics=[topics.TF_STATIC])
    frame_poses = {}
    for part in message.transforms:
        assert part.header.frame_id == "base_link"
        place, turn = part.transform.translation, part.transform.rotation
        frame_poses[part.child_frame_id] = (
            (place.x, place.y, place.z),
            Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(),
        )
    assert [place for place, _ in frame_poses.values()] == [
        (0.0, 0.45, 0.3), (0.0, -0.45, 0.3), (0.0, 0.0, 0.0), (0.5, 0.1, 0.0)
    ]  # fmt: skip
    up, forward, left = np.eye(3)[2], np.eye(3)[0], np.eye(3)[1]
    np.testing.assert_allclose(frame_poses["left"][1].T, [up, forward, left], atol=1e-12)
    np.testing.assert_allclose(frame_poses["right"][1].T, [up, -forward, -left], atol=1e-12)
    np.testing.assert_allclose(frame_poses["gnss"][1], np.eye(3), atol=1e-12)


def test_static_frames_are_repeated_in_the_next_log(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        log.repeat_static_frames(5)
        log.write_static_frames(7, VEHICLE)
        log.repeat_static_frames(2_000_000_009)
    with (tmp_path / "log.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        transforms = [decoded.transforms for *_, decoded in reader.iter_decoded_messages()]
    assert [(t[3].header.stamp.sec, t[3].header.stamp.nanosec) for t in transforms] == [(0, 7), (2, 9)]
    assert [part.transform.translation.z for part in transforms[1]] == [0.3, 0.3, 0.0, 0.0]


def test_a_truth_without_headings_has_none_after_export_and_import(recording, tmp_path):
    truth = Table({name: recording.truth[name] for name in ("t", "x", "y")})
    write_recording(Recording(recording.nodes, truth=truth), tmp_path / "ours.mcap")
    assert hubodo("export", tmp_path / "ours.mcap", "--format", "rosbag2", "-o", tmp_path / "bag").code == 0
    assert list(read_log(tmp_path / "bag").truth) == ["t", "x", "y"]


def test_an_independent_reader_decodes_raw_frames_and_events(tmp_path):
    with LogWriter(tmp_path / "log.mcap") as log:
        for i, frame in enumerate(FRAMES):
            log.write_raw_frame("usb0", i, frame)
        log.write_clock_request("usb0", 4, b"\x07" * 8)
        log.write_event(Event(5, "reset", "left", "brown-out", {"cause": 3}))
    with (tmp_path / "log.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = [(channel.topic, message.data) for _, channel, _, message in reader.iter_decoded_messages()]
    assert [bytes(data) for topic, data in decoded if topic == "/hubodo/raw/usb0"] == FRAMES
    assert [bytes(data) for topic, data in decoded if topic == "/hubodo/asked/usb0"] == [b"\x07" * 8]
    assert json.loads(decoded[-1][1])["data"] == {"cause": 3}


def test_logs_of_earlier_versions_with_bare_events_and_frames_are_read(tmp_path):
    event = {"t_ns": 5, "kind": "reset", "source": "left", "text": "brown-out", "data": {"cause": 3}}
    with LogWriter(tmp_path / "old.mcap", t_zero_ns=0) as log:
        events = log.add_channel(topics.EVENTS, "", "", b"", "json")
        raw = log.add_channel(topics.RAW_PREFIX + "usb0", "hubodo/Frame", "", b"", "hubodo")
        log.write(events, 5, 5, json.dumps(event).encode())
        for i, frame in enumerate(FRAMES):
            log.write(raw, i, i, frame)
    assert read_recording(tmp_path / "old.mcap").events == (Event(**event),)
    assert json.loads(hubodo("info", tmp_path / "old.mcap", "--json").out)["events"][0]["kind"] == "reset"
    with open_log(tmp_path / "old.mcap") as log:
        frame_poses = [
            decode_bytes_message(log.streams[m.channel].encoding, m.data)
            for m in log.messages([topics.RAW_PREFIX + "usb0"])
        ]
    assert frame_poses == FRAMES
