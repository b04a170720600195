"""Hostile MCAP files: wrong types, incomplete schemas, high cost per byte."""

import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from fuzz.seeds import T0
from hubodo.log import cdr_layouts, decode, ros2, scan
from hubodo.log.any_log import read_log
from hubodo.log.decode import ChannelDecoder
from hubodo.log.logfile import open_log
from hubodo.log.mcap_file import McapFile
from in_process import hubodo

HUBODO_METADATA = {"hubodo": {"t_zero_ns": str(T0)}}


def imu(frame: str, gz: float) -> bytes:
    message = cdr_layouts.stamped_layout(ros2.IMU, frame).template.copy()
    message["angular_velocity"][2] = gz
    return message.tobytes()


IMU = [imu("short", 0.0), imu("a_longer_name", 1.0)]
ODOMETRY = cdr_layouts.stamped_layout(ros2.ODOMETRY, "odom", "base").template.tobytes()


def write(
    path: Path,
    messages: Iterable[tuple[str, str, bytes]],
    metadata: dict[str, dict[str, str]] | None = None,
    definition: bytes | None = None,
    chunk_size: int = 1 << 28,
) -> Path:
    """Write messages of topics and types at 1 kHz; definition: replaces the valid one."""
    with path.open("wb") as stream:
        writer, channels = Writer(stream, chunk_size=chunk_size), {}
        writer.start("ros2", "test")
        for name, values in (metadata or {}).items():
            writer.add_metadata(name, values)
        for k, (topic, kind, payload) in enumerate(messages):
            if topic not in channels:
                text = ros2.definition(kind).encode() if definition is None else definition
                channels[topic] = writer.register_channel(
                    topic, "cdr", writer.register_schema(kind, "ros2msg", text)
                )
            writer.add_message(channels[topic], T0 + k * 10**6, payload, T0 + k * 10**6)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("topic", "name", "columns"),
    [
        ("/left/imu", "left", '["t", "gx", "gy", "gz", "ax", "ay", "az"]'),
        ("/gnss/fix", "gnss", '["t", "latitude_deg", "longitude_deg", "altitude"]'),
        ("/hubodo/columns/left", "left", '["t", "gx", "gy", "gz", "ax", "ay", "az"]'),
        ("/hubodo/columns/truth", "truth", '["t", "x", "y"]'),
        ("/left/bias_filter", "left", '["t"]'),
        ("/left/temperature", "left", '["t"]'),
    ],
)
def test_a_hubodo_topic_with_messages_of_another_type_gives_no_table(topic, name, columns, tmp_path):
    rows = [("/right/imu", ros2.IMU, IMU[0]), (topic, ros2.ODOMETRY, ODOMETRY)] * 5
    path = write(tmp_path / "x.mcap", rows, {**HUBODO_METADATA, "hubodo.csv": {name: columns}})
    assert name not in read_log(path).files()
    assert "right" in read_log(path).nodes
    for words in (("info", path, "--json"), ("export", path, "-o", tmp_path / "out")):
        done = hubodo(*words)
        assert done.code == 0, done.err


@pytest.mark.parametrize(
    "definition",
    [
        b"std_msgs/Header header\nfloat64 x",
        b"float64 [",
        b"sensor_msgs/Imu itself\n",
        b"float64[" + b"9" * 5000 + b"] x",
        b"\xff\xfe\x00",
    ],
    ids=["a part is missing", "cut off", "recursive", "5000 digits", "not text"],
)
def test_a_topic_with_an_invalid_schema_is_left_out_of_a_rosbag2(definition, tmp_path):
    rows = [("/hubodo/x", ros2.IMU, IMU[0])] * 3
    path = write(tmp_path / "x.mcap", rows, HUBODO_METADATA, definition)
    done = hubodo("export", path, "--format", "rosbag2", "-o", tmp_path / "bag")
    assert done.code == 0, done.err
    assert "ROS 2 type is incomplete: /hubodo/x" in done.out


@pytest.mark.parametrize("kind", ["undecodable", "alternating"])
def test_the_number_of_searches_for_messages_is_bounded(kind, tmp_path, monkeypatch):
    n = 4000
    payloads = [cdr_layouts.ENCAPSULATION + b"\xff" * 8] * 2 if kind == "undecodable" else IMU
    path = write(tmp_path / "x.mcap", (("/imu", ros2.IMU, payloads[i % 2]) for i in range(n)))
    located = []
    fitting = ChannelDecoder._count_matching
    monkeypatch.setattr(
        ChannelDecoder,
        "_count_matching",
        lambda *args: located.append(len(args[2])) or fitting(*args),
        raising=True,
    )
    recording = read_log(path)
    assert sum(located) <= (decode._MIN_WINDOW_MESSAGES + 4) * n
    if kind == "alternating":
        assert sum(located) <= 6 * n
        table = recording.nodes["imu"]
        np.testing.assert_allclose(table.t, np.arange(n) * 1e-3, rtol=0, atol=1e-9)
        assert np.array_equal(table["gz"], np.arange(n) % 2)


def test_a_channel_with_a_new_layout_in_each_message_is_decoded_up_to_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(decode, "MAX_LAYOUT_CHANGES", 50)
    payloads = [cdr_layouts.ENCAPSULATION + b"\xff" * 8] * 200
    path = write(tmp_path / "x.mcap", (("/imu", ros2.IMU, payload) for payload in payloads))
    measured = []
    measure = cdr_layouts.infer_layout
    monkeypatch.setattr(cdr_layouts, "infer_layout", lambda *args: measured.append(1) or measure(*args))
    assert any("200 messages of /imu do not match" in line for line in read_log(path).warnings)
    assert len(measured) == 50


def test_decoded_messages_stay_within_the_memory_limit(tmp_path):
    rows = (("/imu", ros2.IMU, IMU[0]) for _ in range(20_000))
    path = write(tmp_path / "x.mcap", rows, chunk_size=1 << 20)
    for limit, what in ((5, "the array of its samples"), (2, "a chunk")):
        done = hubodo("export", path, "-o", tmp_path / "out", "--max-memory", limit)
        assert done.code == 2
        assert f"{what} needs" in done.err and f"the limit is {limit} MB" in done.err
    assert hubodo("export", path, "-o", tmp_path / "out", "--max-memory", 60).code == 0


def test_chunks_that_overlap_in_time_stay_within_the_memory_limit(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=20_000)
        writer.start("ros2", "test")
        schema = writer.register_schema(ros2.IMU, "ros2msg", ros2.definition(ros2.IMU).encode())
        channel = writer.register_channel("/hubodo/imu", "cdr", schema)
        for k in range(3000):
            writer.add_message(channel, T0 + k % 50, IMU[0], T0)
        writer.finish()
    done = hubodo("export", path, "--format", "rosbag2", "-o", tmp_path / "bag", "--max-memory", 1)
    assert done.code == 2
    assert "chunks that overlap in time" in done.err


def test_damaged_chunks_and_the_bytes_between_them_are_read_once(tmp_path, monkeypatch):
    file = McapFile(tmp_path / "x.mcap")
    head = struct.pack("<QQQII", 1, 2, 4, 0, 0) + struct.pack("<Q", 4) + b"\xff" * 4
    n = 300
    file.append_records((struct.pack("<BQ", 6, len(head)) + head + bytes(9)) * n)
    file.finish()
    searched = []
    pread = scan.pread
    monkeypatch.setattr(scan, "pread", lambda *args: searched.append(args[1]) or pread(*args))
    with open_log(tmp_path / "x.mcap") as log:
        list(log.chunks())
        assert sum(searched) < n * 2 * scan._MIN_SEARCH_BYTES
        assert sum("holds" in line or "undecodable" in line for line in log.warnings()) == n
