"""Writing a log: independent readers decode every number, and messages are on disk within a bounded time."""

import errno
import json
import os
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from hubodo.errors import InputError
from hubodo.log import chunk_writer
from hubodo.log.hubodo_messages import decode_bytes_message, decode_string_message
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.recording import Event

ROS_TOPICS = {
    "/left/imu": "sensor_msgs/msg/Imu",
    "/right/imu": "sensor_msgs/msg/Imu",
    "/left/temperature": "sensor_msgs/msg/Temperature",
    "/left/battery": "sensor_msgs/msg/BatteryState",
    "/left/mag": "sensor_msgs/msg/MagneticField",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/gnss/fix": "sensor_msgs/msg/NavSatFix",
    "/hubodo/columns/wheels": "std_msgs/msg/Float64MultiArray",
}
OWN_TOPICS = {
    "/hubodo/raw/usb0": "std_msgs/msg/UInt8MultiArray",
    "/hubodo/events": "std_msgs/msg/String",
}
T0 = 1_700_000_000_123_456_789


def numbers(seed: int = 5, n: int = 300) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    samples = {name: rng.normal(size=(n, 3)) for name in ("gyro", "accel", "field", "sigma")}
    samples |= {name: rng.normal(size=n) for name in ("heading", "speed", "yaw_rate", "lat", "lon", "alt")}
    samples |= {name: rng.normal(size=n) for name in ("heat", "volts")}
    samples |= {
        "xy": rng.normal(size=(n, 2)),
        "pose": rng.normal(size=(n, 3, 3)),
        "twist": rng.normal(size=(n, 2, 2)),
    }
    samples["t"] = T0 + np.cumsum(rng.integers(1, 10_000_000, n))
    return samples


def write_everything(log: LogWriter, d: dict[str, np.ndarray]) -> None:
    """Write every kind of message in batches of different sizes, received 3 ms after its measurement."""
    for first in range(0, len(d["t"]), 37):
        p = slice(first, first + 37)
        t, received = d["t"][p], d["t"][p] + 3_000_000
        log.write_imu("left", t, received, d["gyro"][p], d["accel"][p])
        log.write_imu("right", t, received, -d["gyro"][p], -d["accel"][p])
        log.write_temperature("left", t, received, d["heat"][p])
        log.write_battery("left", t, received, d["volts"][p], 0.75)
        log.write_magnetic_field("left", t, received, d["field"][p])
        log.write_odometry(
            t, received, d["xy"][p], d["heading"][p], d["speed"][p], d["yaw_rate"][p],
            pose_covariance=d["pose"][p], twist_covariance=d["twist"][p],
        )  # fmt: skip
        log.write_transform(t, received, d["xy"][p], d["heading"][p])
        log.write_gnss_fix(t, received, d["lat"][p], d["lon"][p], d["alt"][p], sigma=d["sigma"][p])
        log.write_columns("wheels", t, received, {"left": d["speed"][p], "right": d["yaw_rate"][p]})
        log.write_raw_frame("usb0", int(received[0]), bytes(range(first % 100)))
        log.write_event(Event(int(received[0]), "gap", "left", "lost", {"samples_lost": first}))


def check_message(topic: str, i: int, m: object, d: dict[str, np.ndarray]) -> None:
    """Compare a message decoded by an independent reader (attributes as in ROS) with the data written."""
    if topic.startswith("/hubodo/columns"):
        assert list(m.data) == [d["speed"][i], d["yaw_rate"][i]]
        assert (len(m.layout.dim), m.layout.dim[0].size) == (1, 2)
        return
    part = m.transforms[0] if topic == "/tf" else m
    assert part.header.stamp.sec * 10**9 + part.header.stamp.nanosec == d["t"][i]
    half = d["heading"][i] / 2
    if topic.endswith("/imu"):
        sign = 1 if topic == "/left/imu" else -1
        assert m.header.frame_id == topic.split("/")[1]
        assert xyz(m.angular_velocity) == (sign * d["gyro"][i]).tolist()
        assert xyz(m.linear_acceleration) == (sign * d["accel"][i]).tolist()
        assert m.orientation_covariance[0] == -1
    elif topic == "/left/temperature":
        assert (m.temperature, m.variance) == (d["heat"][i], 0)
    elif topic == "/left/battery":
        assert (m.voltage, m.percentage, m.present) == (np.float32(d["volts"][i]), 0.75, True)
        unknown = (m.temperature, m.current, m.charge, m.capacity, m.design_capacity)
        assert np.isnan(unknown).all()
        assert (m.power_supply_status, m.power_supply_health, m.power_supply_technology) == (0, 0, 0)
        assert (len(m.cell_voltage), len(m.cell_temperature)) == (0, 0)
        assert (m.location, m.serial_number) == ("", "")
    elif topic == "/left/mag":
        assert xyz(m.magnetic_field) == d["field"][i].tolist()
    elif topic == "/odom":
        assert (m.header.frame_id, m.child_frame_id) == ("odom", "base_link")
        assert xyz(m.pose.pose.position) == [*d["xy"][i], 0]
        assert (m.pose.pose.orientation.z, m.pose.pose.orientation.w) == (np.sin(half), np.cos(half))
        assert (m.twist.twist.linear.x, m.twist.twist.angular.z) == (d["speed"][i], d["yaw_rate"][i])
        pose, twist = np.reshape(m.pose.covariance, (6, 6)), np.reshape(m.twist.covariance, (6, 6))
        assert (pose[np.ix_([0, 1, 5], [0, 1, 5])] == d["pose"][i]).all()
        assert (twist[np.ix_([0, 5], [0, 5])] == d["twist"][i]).all()
        assert np.diag(pose)[2:5].tolist() == np.diag(twist)[2:5].tolist() == [1e6] * 3
        assert (np.count_nonzero(pose), np.count_nonzero(twist)) == (12, 8)
    elif topic == "/tf":
        assert (part.header.frame_id, part.child_frame_id) == ("odom", "base_link")
        assert xyz(part.transform.translation) == [*d["xy"][i], 0]
        assert (part.transform.rotation.z, part.transform.rotation.w) == (np.sin(half), np.cos(half))
    elif topic == "/gnss/fix":
        assert (m.latitude, m.longitude, m.altitude) == (d["lat"][i], d["lon"][i], d["alt"][i])
        assert (np.diag(np.reshape(m.position_covariance, (3, 3))) == d["sigma"][i] ** 2).all()
        assert (m.position_covariance_type, m.status.status, m.status.service) == (2, 0, 1)
    else:
        raise AssertionError(topic)


def xyz(vector: object) -> list[float]:
    return [vector.x, vector.y, vector.z]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_rosbags_reads_every_type_with_the_same_numbers(compression, tmp_path: Path) -> None:
    data = numbers()
    with LogWriter(tmp_path / "log.mcap", compression=compression, chunk_bytes=100_000) as log:
        write_everything(log, data)
    counts = dict.fromkeys(ROS_TOPICS, 0)
    with AnyReader([tmp_path / "log.mcap"]) as reader:
        types = {c.topic: c.msgtype for c in reader.connections if c.msgdef.data}
        assert types == ROS_TOPICS | OWN_TOPICS
        for connection, received, raw in reader.messages():
            if connection.topic in counts:
                i = counts[connection.topic]
                assert received == data["t"][i] + 3_000_000
                check_message(connection.topic, i, reader.deserialize(raw, connection.msgtype), data)
                counts[connection.topic] += 1
    assert set(counts.values()) == {300}


def test_mcap_ros2_support_reads_every_type_with_the_same_numbers(tmp_path: Path) -> None:
    data = numbers(seed=6)
    with LogWriter(tmp_path / "log.mcap", chunk_bytes=100_000) as log:
        write_everything(log, data)
    counts = dict.fromkeys(ROS_TOPICS, 0)
    with (tmp_path / "log.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=list(ROS_TOPICS)):
            i = counts[channel.topic]
            assert (message.publish_time, message.sequence) == (data["t"][i], i)
            check_message(channel.topic, i, decoded, data)
            counts[channel.topic] += 1
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics.message_count == 300 * len(ROS_TOPICS) + 2 * 9
        assert sum(summary.statistics.channel_message_counts.values()) == summary.statistics.message_count
    assert set(counts.values()) == {300}


def test_the_mcap_package_accepts_every_checksum(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap", chunk_bytes=50_000, metadata={"fingerprint": "abc"}) as log:
        write_everything(log, numbers())
        log.add_attachment("hubodo.toml", "application/toml", b"rate_hz = 208\n")
    # Checksums that the mcap package does not verify, computed as specified.
    data = (tmp_path / "log.mcap").read_bytes()
    start, offsets, crc = struct.unpack("<QQI", data[-28:-8])
    assert crc == zlib.crc32(data[start:-12])
    assert data[offsets] == Opcode.SUMMARY_OFFSET
    end = start - 13
    assert struct.unpack("<BQI", data[end:start]) == (Opcode.DATA_END, 4, zlib.crc32(data[:end]))
    with (tmp_path / "log.mcap").open("rb") as stream:
        kinds = [type(record).__name__ for record in StreamReader(stream, validate_crcs=True).records]
    assert kinds[0] == "Header"
    assert kinds[-1] == "Footer"
    with (tmp_path / "log.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("hubodo.toml", b"rate_hz = 208\n")]
        assert {m.name: m.metadata["fingerprint"] for m in reader.iter_metadata()} == {"hubodo": "abc"}
        assert len(list(reader.iter_messages())) == 300 * len(ROS_TOPICS) + 2 * 9


def test_the_reader_returns_the_data_of_a_live_recording(tmp_path: Path) -> None:
    d = numbers()
    with LogWriter(tmp_path / "log.mcap", t_zero_ns=T0, metadata={"fingerprint": "abc"}) as log:
        write_everything(log, d)
    recording = read_recording(tmp_path / "log.mcap")
    left, t = recording.nodes["left"], (d["t"] - T0) / 1e9
    assert list(recording.nodes) == ["left", "right"]
    for table in (
        left,
        recording.odometry,
        recording.gnss,
        recording.wheels,
        recording.magnetometers["left"],
    ):
        assert table.t.tolist() == t.tolist()
    assert left.gyro.tolist() == d["gyro"].tolist()
    assert left.accel.tolist() == d["accel"].tolist()
    assert left["temperature"].tolist() == d["heat"].tolist()
    assert left["supply"].tolist() == d["volts"].astype(np.float32).tolist()
    assert not {"temperature", "supply"} & set(recording.nodes["right"])
    assert recording.gnss["latitude_deg"].tolist() == d["lat"].tolist()
    np.testing.assert_allclose(recording.gnss["sigma"] ** 2, (d["sigma"][:, :2] ** 2).mean(axis=1))
    assert recording.magnetometers["left"]["mz"].tolist() == d["field"][:, 2].tolist()
    assert recording.wheels["right"].tolist() == d["yaw_rate"].tolist()
    assert recording.odometry["speed"].tolist() == d["speed"].tolist()
    turned = np.exp(1j * recording.odometry["heading"]) / np.exp(1j * d["heading"])
    np.testing.assert_allclose(turned, 1, atol=1e-12)
    assert [event.data["samples_lost"] for event in recording.events] == list(range(0, 300, 37))
    assert recording.metadata["fingerprint"] == "abc"
    assert recording.warnings == ()


def test_raw_frames_and_events_are_preserved_byte_by_byte(tmp_path: Path) -> None:
    frames = [os.urandom(n) for n in (0, 1, 250, 12)]
    with LogWriter(tmp_path / "log.mcap") as log:
        for i, frame in enumerate(frames):
            log.write_raw_frame("usb0", 100 + i, frame)
        log.write_event(Event(200, "reset", "left", "brown-out", {"cause": 3}))
    with open_log(tmp_path / "log.mcap") as read:
        messages = list(read.messages(topics=["/hubodo/raw/usb0"]))
        assert [decode_bytes_message("cdr", m.data) for m in messages] == frames
        assert [m.log_time for m in messages] == [100, 101, 102, 103]
        (event,) = read.messages(topics=["/hubodo/events"])
    assert json.loads(decode_string_message("cdr", event.data))["data"] == {"cause": 3}


class Clock:
    """A substitute for time.monotonic_ns that the test sets."""

    now = 0

    def __call__(self) -> int:
        return self.now


def count_on_disk(path: Path) -> int:
    """Return the number of messages readable now, as if the writer were killed."""
    with open_log(path) as log:
        return sum(len(messages.offsets) for messages in log.chunks())


def test_messages_are_on_disk_within_the_bound_even_without_further_ones(tmp_path: Path) -> None:
    clock = Clock()
    log = LogWriter(tmp_path / "log.mcap", pending_s=0.5, clock=clock)
    log.write_raw_frame("usb0", 1, b"first")
    clock.now = 499_999_999
    log.tick()
    assert count_on_disk(log.path) == 0
    clock.now = 500_000_000
    log.tick()
    assert count_on_disk(log.path) == 1
    log.write_raw_frame("usb0", 2, b"second")
    clock.now += 400_000_000
    log.write_raw_frame("usb0", 3, b"third")
    clock.now += 100_000_000
    log.write_raw_frame("usb0", 4, b"fourth")
    assert count_on_disk(log.path) == 4
    log.close()


def test_an_event_is_on_disk_at_once_with_all_earlier_messages(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log.mcap", clock=Clock())
    log.write_raw_frame("usb0", 1, b"before")
    log.write_event(Event(2, "disconnected", "usb0", "unplugged", {}))
    assert count_on_disk(log.path) == 2
    log.close()


def test_a_full_chunk_is_written_without_waiting(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log.mcap", clock=Clock(), chunk_bytes=10_000)
    for i in range(100):
        log.write_raw_frame("usb0", i, bytes(200))
    assert count_on_disk(log.path) >= 81
    log.close()


def test_an_existing_file_is_refused_and_unchanged(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already"):
        LogWriter(tmp_path / "log.mcap")
    assert (tmp_path / "log.mcap").read_bytes() == b"precious"
    with pytest.raises(InputError, match="folder does not exist"):
        LogWriter(tmp_path / "absent" / "log.mcap")


def test_closing_a_long_log_needs_no_copy_of_its_index(tmp_path):
    """The index of 6,000 chunks takes 0.6 MB and is written without a copy."""
    log = LogWriter(tmp_path / "a.mcap", clock=None, compression="none")
    for k in range(6_000):
        log.write_raw_frame("usb0", k, b"frame")
        log.flush()
    tracemalloc.start()
    try:
        log.close()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 150_000
    with open_log(tmp_path / "a.mcap") as read:
        assert sum(1 for _ in read.messages()) == 6_000
        assert read.warnings() == ()


def test_a_full_disk_loses_only_pending_messages_and_leaves_a_valid_log(tmp_path: Path, monkeypatch) -> None:
    real, room = os.write, [None]

    def write(fd: int, data: bytes) -> int:
        """Write until `room` bytes are left, then write half of the data, then raise ENOSPC."""
        if room[0] is None:
            return real(fd, data)
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        accepted, room[0] = min(room[0], len(data)), room[0] - min(room[0], len(data))
        return real(fd, bytes(data)[:accepted])

    log = LogWriter(tmp_path / "log.mcap", clock=Clock())
    log.write_raw_frame("usb0", 1, b"kept")
    log.flush()
    monkeypatch.setattr(os, "write", write)
    room[0] = 10
    log.write_raw_frame("usb0", 2, b"lost")
    with pytest.raises(OSError, match="No space"):
        log.flush()
    room[0] = None
    log.write_raw_frame("usb0", 3, b"kept again")
    log.close()
    with open_log(tmp_path / "log.mcap") as read:
        assert [decode_bytes_message("cdr", m.data) for m in read.messages()] == [b"kept", b"kept again"]
        assert read.warnings() == ()


@pytest.mark.parametrize(
    "n",
    [
        1,
        2,
        8,
        chunk_writer.MAX_PENDING_ROWS - 1,
        chunk_writer.MAX_PENDING_ROWS,
        chunk_writer.MAX_PENDING_ROWS + 1,
        3 * chunk_writer.MAX_PENDING_ROWS + 5,
    ],
)
def test_batches_of_any_size_keep_order_and_numbering(n: int, tmp_path: Path) -> None:
    gyro = np.arange(3.0 * n).reshape(n, 3)
    t = np.arange(n) * 1_000_000
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write_imu("left", t, t + 1, gyro, -gyro)
        log.write_imu("left", t + 10**12, 10**12, gyro, -gyro)
        assert log.message_count == 2 * n
    with open_log(tmp_path / "log.mcap") as read:
        heads = np.concatenate([messages.headers for messages in read.chunks()])
    assert heads["sequence"].tolist() == list(range(2 * n))
    assert heads["log_time"][:n].tolist() == (t + 1).tolist()
    assert (heads["log_time"][n:] == 10**12).all()
    left = read_recording(tmp_path / "log.mcap").nodes["left"]
    assert left.gyro.tolist() == np.vstack([gyro, gyro]).tolist()


def test_wrong_shapes_and_negative_times_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        with pytest.raises(ValueError, match="angular_velocity has shape"):
            log.write_imu("left", [1, 2], 3, np.zeros((3,)), np.zeros((2, 3)))
        with pytest.raises(ValueError, match="linear_acceleration has shape"):
            log.write_imu("left", [1, 2], 3, np.zeros((2, 3)), np.zeros((1, 3)))
        with pytest.raises(ValueError, match="negative time"):
            log.write_imu("left", [-1], 3, np.zeros((1, 3)), np.zeros((1, 3)))
        with pytest.raises(ValueError, match="negative time"):
            log.write_raw_frame("usb0", -1, b"")
        assert log.message_count == 0
