"""Small valid inputs to mutate: logs of hubodo and other programs, a CSV folder, settings."""

from __future__ import annotations

import io
import random
import sqlite3
import struct
import tomllib
from contextlib import closing
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Bag1
from rosbags.typesys import Stores, get_typestore

from hubodo.log import cdr_layouts, ros2
from hubodo.log.log_writer import LogWriter
from hubodo.recording import Event
from hubowire import FINGERPRINT, MESSAGES, Frame, FrameDecoder, encode, encode_frame
from hubowire.codec import payload_layout
from hubowire.messages import Filter, Health, Hello, ImuBatch, Mag, TimeReply
from vehicles import DRIVE_MODEL, LOW_INPUT_NOISE, vehicle_toml

MODEL = f"""
{DRIVE_MODEL}{LOW_INPUT_NOISE}[effects.gyro_bias]
z = 0.002
[nodes.left.effects.wheel_radius]
error = 0.001
"""
VEHICLE = (
    vehicle_toml(more="antenna = [0.5, 0.0]\nlatitude_deg = 47.4\n", imu="gyro_range = 35.0\n")
    + "steered = false\n"
)
CALIBRATION = """
[nodes.left]
serial = "abc"
[nodes.left.effects.gyro_bias]
method = "rest"
source_sha256 = "00"
date = "2026-01-01"
temperature_min = 10.0
temperature_max = 30.0
x = { value = 0.001, sigma = 0.0001 }
z = { value = 0.002, sigma = 0.0001 }
[nodes.left.effects.gyro_scale_factor]
z = { value = 0.01, sigma = 0.001 }
[nodes.left.effects.gyro_warmup]
z = { value = 0.01, sigma = 0.001 }
time_constant = { value = 300.0, sigma = 10.0 }
[nodes.left.effects.wheel_radius]
error = { value = 0.01, sigma = 0.001 }
[vehicle.effects.track_width]
error = { value = 0.01, sigma = 0.001 }
"""
DATASHEET = """
name = "chip"
[gyro]
noise_density = 0.01
bias_instability = 5.0
rate_random_walk = 3.0
[accel]
velocity_random_walk = 0.1
bias_instability = 40.0
"""
RECORD = """
[record]
ports = ["left=/dev/nope"]
output = "x.mcap"
baud = 115200
wait = false
duration = 0.1
compression = "zstd"
odometry_rate_hz = 50.0
clock_request_period = 1.0
time_scale = 1.0
[web]
hosts = ["recorder.lan"]
"""
KEYS = f"""
[keys]
e6614103e7452d2f = "{"ab" * 32}"
"""
FLEET = """
[nodes]
e6614103e7452d2f = "left"
e6614103e7452d30 = "right"
"""
NMEA = (
    b"$GPGGA,123519.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*59\r\n"
    b"$GPRMC,123519.00,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*44\r\n"
    b"$GPGST,123519.00,1.0,2.0,1.0,0.0,1.0,1.0,2.0*6A\r\n"
)
T0 = 1_700_000_000 * 10**9
HELLO = Hello(
    FINGERPRINT, (1, 2, 3), b"serial01", 77, 1, 1, 208_000, 2000, 16,
    70_000_000, 488_000, 62_500, 25_000_000, 14_614_000, 8, 0, 40, ((0x6B, 0x69, 1),),
)  # fmt: skip


def document(text: str) -> dict[str, Any]:
    return tomllib.loads(text)


def node_frames(seconds: float = 2.0) -> list[tuple[int, bytes]]:
    """Return the frames of a node at 208 Hz, as (ns from the start, frame with its delimiters)."""
    messages: list[tuple[int, Any]] = [(0, HELLO)]
    period = 4_807_692
    for k in range(round(seconds * 208 / 8)):
        t = 8 * k * period
        rows = tuple((100 * i, -5, 300, 2000, i, 300) for i in range(8))
        messages.append((t, ImuBatch((t // 1000) % (1 << 30), period, (8 * k) & 0xFFFF, 160, 0, rows)))
        if k % 10 == 5:
            messages.append((t, Mag((t // 1000) % (1 << 30), (1, 2, 3))))
            messages.append((t, Health(0, 3700, 0, 0, 0, 0, 0, 0, 0, 1, 900, 1, 50_000, 40)))
            messages.append(
                (t, Filter((t // 1000) % (1 << 30), 2, 0, 100, (0, 0, 0), (1, 2, 3), (4, 5, 6), (7, 8, 9)))
            )
            messages.append((t, TimeReply(k.to_bytes(8, "little"), t // 1000, t // 1000 + 5)))
    wires, seqs = [], dict[int, int]()
    for t, message in messages:
        seq = seqs.get(message.type_id, 0)
        seqs[message.type_id] = (seq + 1) & 0xFFFF
        wires.append((t, encode_frame(Frame(message.type_id, 1, seq, encode(message)))))
    return wires


def our_log(path: Path) -> bytes:
    """Return a log with samples, GNSS, odometry, raw frames, events, columns, attachments and metadata."""
    metadata = {"ports": "left=/dev/ttyACM0", "odometry_rate_hz": "50"}
    with LogWriter(path, t_zero_ns=T0, chunk_bytes=4000, clock=None, metadata=metadata) as log:
        log.add_attachment("vehicle.toml", "application/toml", VEHICLE.encode())
        log.add_metadata("node.left", {"serial": "abc", "fingerprint": f"{FINGERPRINT:08x}"})
        for t, wire in node_frames(0.5):
            log.write_raw_frame("left", T0 + t, wire)
        for k in range(0, 64, 8):
            t = T0 + (k + np.arange(8)) * 5_000_000
            log.write_imu("left", t, t + 1000, np.full((8, 3), 0.01 * k), np.full((8, 3), 3.0))
            log.write_temperature("left", t[:1], t[:1], [20.0])
            log.write_battery("left", t[:1], t[:1], [3.7], 0.5)
            log.write_gnss_fix(t[:1], t[:1], [47.0], [8.0], [400.0], sigma=[[1.0, 1.0, 2.0]])
            log.write_odometry(t[:1], t[:1], [[1.0, 2.0]], [0.1], [1.0], [0.0])
            log.write_columns("reference", t[:1], t[:1], {"speed": [1.0], "yaw_rate": [0.1]})
            rows = [k + 1, 1, 0, *[0.0] * 12]
            log.write_bias_filter(
                "left", t[:1], t[:1], dict(zip(_FILTER, np.array(rows)[:, None], strict=True))
            )
        log.write_event(
            Event(T0 + 5, "gap", "left", "lost", {"node": "left", "samples_lost": 3, "duration_s": 0.02})
        )
        log.write_event(Event(T0 + 6, "health", "left", "well", {"node": "left", "battery_mv": 3700}))
        log.write_event(Event(T0 + 7, "started", "left", "on", {"node": "left", "power_on_ns": T0}))
    return path.read_bytes()


_FILTER = (
    "state", "samples", "saturations",
    *(f"{what}_{axis}" for what in ("rate", "bias", "noise", "sigma") for axis in "xyz"),
)  # fmt: skip


def foreign_log(*, chunked: bool, crcs: bool) -> bytes:
    """Return Imu, NavSatFix and Odometry as the mcap package writes them, with channels inside chunks."""
    out = io.BytesIO()
    kind = CompressionType.LZ4 if crcs else CompressionType.ZSTD
    writer = Writer(out, compression=kind, use_chunking=chunked, chunk_size=3000, enable_crcs=crcs)
    writer.start("ros2", "somebody else")
    for topic, name in (("/imu", ros2.IMU), ("/fix", ros2.NAV_SAT_FIX), ("/odom", ros2.ODOMETRY)):
        schema = writer.register_schema(name, "ros2msg", ros2.definition(name).encode())
        channel = writer.register_channel(topic, "cdr", schema)
        layout = cdr_layouts.stamped_layout(name, "frame", "child" if name == ros2.ODOMETRY else "")
        for k in range(30):
            writer.add_message(channel, T0 + k * 10_000_000, layout.template.tobytes(), T0 + k * 10_000_000)
    writer.add_metadata("someone", {"a": "b"})
    writer.finish()
    return out.getvalue()


BAG_SCHEMA = """
CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
BAG_TOPICS = (("/left/imu", ros2.IMU), ("/gps/fix", ros2.NAV_SAT_FIX), ("/odom", ros2.ODOMETRY))
BAG_METADATA = (
    "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n"
    "  relative_file_paths:\n    - bag_0.db3\n  compression_format: '{form}'\n  compression_mode: '{mode}'\n"
)


def bag_database(n_messages: int = 30) -> bytes:
    """Return the SQLite file of a rosbag2 with Imu, NavSatFix and Odometry."""
    with closing(sqlite3.connect(":memory:")) as base:
        base.executescript(BAG_SCHEMA)
        for number, (topic, kind) in enumerate(BAG_TOPICS, 1):
            base.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr')", (number, topic, kind))
            layout = cdr_layouts.stamped_layout(kind, "frame", "child" if kind == ros2.ODOMETRY else "")
            for k in range(n_messages):
                row = (number, T0 + k * 10_000_000, layout.template.tobytes())
                base.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
        base.commit()
        return bytes(base.serialize())


@cache
def ros1_bag() -> bytes:
    """Return a ROS 1 bag with Imu and Odometry, compressed by bz2."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with TemporaryDirectory(prefix="hubodo-fuzz-") as folder:
        path = Path(folder) / "x.bag"
        writer = Bag1(path)
        writer.set_compression(Bag1.CompressionFormat.BZ2)
        with writer as bag:
            # After its header an Imu has 37 numbers, a Temperature two.
            for topic, kind, numbers in (("/imu", ros2.IMU, 37), ("/t", ros2.TEMPERATURE, 2)):
                link = bag.add_connection(topic, kind, typestore=store)
                for k in range(20):
                    header = struct.pack("<IIII", k, T0 // 10**9 + k, 0, 0)
                    bag.write(link, T0 + k * 10**9, header + bytes(8 * numbers))
        return path.read_bytes()


def wild_frame(rng: random.Random) -> bytes:
    """Return a frame of a random message with random fields."""
    kind = rng.choice(MESSAGES if not isinstance(MESSAGES, dict) else list(MESSAGES.values()))
    size = rng.choice(
        (payload_layout(kind).fixed.size, rng.randrange(64), payload_layout(kind).fixed.size + 12)
    )
    body = bytes(rng.choice((0, 0xFF, 0x7F, 0x80, rng.randrange(256))) for _ in range(size))
    return encode_frame(Frame(kind.type_id, rng.choice((0, 1, 1, 1, 2, 255)), rng.randrange(1 << 16), body))


def bent_frame(rng: random.Random, wire: bytes) -> bytes:
    """Return the frame with changed payload bytes and a valid checksum."""
    decoder = FrameDecoder()
    frames = [
        frame for part in decoder.split_frames(wire) if isinstance(frame := decoder.decode_frame(part), Frame)
    ]
    if not frames:
        return wire
    body = bytearray(frames[0].payload)
    for _ in range(rng.randint(1, 3)):
        if body:
            at = rng.randrange(len(body))
            body[at : at + 1] = bytes([rng.choice((0, 0xFF, 0x80, rng.randrange(256)))])
    node = rng.choice((frames[0].node, frames[0].node, 9))
    seq = rng.choice((frames[0].seq, (frames[0].seq + rng.choice((1, 100, 40_000, 65_535))) & 0xFFFF))
    return encode_frame(Frame(frames[0].type_id, node, seq, bytes(body)))
