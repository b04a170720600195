"""Logs of one drive as other programs write them: two wheel IMUs, odometry, fixes, joints, an unknown type.

Topics, frames and times are those of a robot that knows nothing of hubodo: messages are recorded in bursts,
up to 70 ms after their stamps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from foxglove import Channel, Context, Schema, open_mcap
from mcap_ros2.writer import Writer as Ros2Support
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore

from generators.gnss_drives import geodetic
from hubodo.model import experiments
from hubodo.model.drive import loop_drive
from hubodo.model.experiments import Experiment
from hubodo.model.model_file import read_model
from hubodo.recording import Recording
from vehicles import FROM_REFERENCE, model_toml

T0 = 1_700_000_000_000_000_000
RADIUS = 0.25
MODEL = model_toml(RADIUS, 0.8, inputs=FROM_REFERENCE + "speed_noise = 0.001\nyaw_rate_noise = 0.001\n")
SECONDS, RATE = 40.0, 100.0
WRITERS = ("rosbag", "rosbag2", "mcap-ros2-support", "foxglove-sdk")
TOPICS = {
    "/imu/left_wheel": "sensor_msgs/msg/Imu",
    "/imu/right_wheel": "sensor_msgs/msg/Imu",
    "/wheel/odometry": "nav_msgs/msg/Odometry",
    "/gps/fix": "sensor_msgs/msg/NavSatFix",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/camera/info": "std_msgs/msg/String",
}


@dataclass(frozen=True)
class RosMessage:
    """A message to write. t: stamp, s; values: its content, converted by `message`."""

    topic: str
    t: float
    values: Any


def drive(folder: Path) -> Recording:
    """Return a loop of two nodes with reference and truth; its model.toml is in the folder."""
    (folder / "model.toml").write_text(MODEL, "utf-8")
    model = read_model(folder / "model.toml")
    inputs = loop_drive(np.random.default_rng(3), rest_time=5.0, driving_time=SECONDS - 6.0)
    return experiments.simulate(model, Experiment("loop", inputs), RATE, 50.0, 3)


def messages(recording: Recording, *, leave_out: tuple[str, ...] = ()) -> list[RosMessage]:
    """Return all messages of the robot, by time."""
    sent: list[RosMessage] = []
    for node in ("left", "right"):
        table = recording.nodes[node]
        sent += [
            RosMessage(f"/imu/{node}_wheel", t, row)
            for t, row in zip(table.t, np.hstack([table.gyro, table.accel]), strict=True)
        ]
    ref, truth = recording.reference, recording.truth
    assert ref is not None
    assert truth is not None
    x, y = np.interp(ref.t, truth.t, truth["x"]), np.interp(ref.t, truth.t, truth["y"])
    for row in zip(ref.t, x, y, ref["speed"], ref["yaw_rate"], strict=True):
        sent.append(RosMessage("/wheel/odometry", row[0], row[1:]))
        contact = [(row[3] - row[4] * side * 0.4) / RADIUS for side in (1.0, -1.0)]
        sent.append(RosMessage("/joint_states", row[0], contact))
    noise = np.random.default_rng(4).normal(0.0, 0.5, (len(truth.t), 2))
    latitude, longitude = geodetic(truth["x"] + noise[:, 0], truth["y"] + noise[:, 1], 47.0, 8.0)
    sent += [
        RosMessage("/gps/fix", t, at)
        for t, *at in zip(truth.t[::4], latitude[::4], longitude[::4], strict=True)
    ]
    sent.append(RosMessage("/camera/info", 0.0, "a picture"))
    return sorted((it for it in sent if it.topic not in leave_out), key=lambda it: (it.t, it.topic))


def received(sent: list[RosMessage]) -> Iterator[tuple[int, int, RosMessage]]:
    """Yield stamp and recording time, ns, of each message: recorded in bursts of 50 ms."""
    for number, it in enumerate(sent):
        stamp = T0 + round(it.t * 1e9)
        yield stamp, T0 + (int(it.t / 0.05) + 1) * 50_000_000 + 20_000_000 + number, it


def write(path: Path, writer: str, sent: list[RosMessage]) -> Path:
    """Write the log with one of WRITERS and return its path."""
    return {
        "rosbag": _rosbag,
        "rosbag2": _rosbag2,
        "mcap-ros2-support": _ros2_support,
        "foxglove-sdk": _foxglove,
    }[writer](path, sent)


def message(store: Any, it: RosMessage, stamp: int, *, ros1: bool = False, array: Any = np.array) -> Any:
    """Return the message as an object of the typestore. array: constructor of its arrays."""
    types = store.types

    def of(name: str, *values: Any) -> Any:
        return types[name](*values)

    vector = lambda x, y, z: of("geometry_msgs/msg/Vector3", x, y, z)  # noqa: E731
    time = of("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)
    header = of("std_msgs/msg/Header", *((7,) if ros1 else ()), time, "some_frame")
    kind, none, unknown = TOPICS[it.topic], array([0.0] * 9), array([0.0] * 36)
    turn = of("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    if kind.endswith("Imu"):
        values = list(map(float, it.values))
        no_turn = array([-1.0, *none[1:]])
        return of(kind, header, turn, no_turn, vector(*values[:3]), none, vector(*values[3:]), none)
    if kind.endswith("Odometry"):
        x, y, speed, yaw_rate = map(float, it.values)
        pose = of("geometry_msgs/msg/Pose", of("geometry_msgs/msg/Point", x, y, 0.0), turn)
        twist = of("geometry_msgs/msg/Twist", vector(speed, 0.0, 0.0), vector(0.0, 0.0, yaw_rate))
        return of(
            kind,
            header,
            "base_footprint",
            of("geometry_msgs/msg/PoseWithCovariance", pose, unknown),
            of("geometry_msgs/msg/TwistWithCovariance", twist, unknown),
        )
    if kind.endswith("NavSatFix"):
        status = of("sensor_msgs/msg/NavSatStatus", 0, 1)
        covariance = array([0.25, 0, 0, 0, 0.25, 0, 0, 0, 1.0])
        return of(kind, header, status, *map(float, it.values), 40.0, covariance, 2)
    if kind.endswith("JointState"):
        names = ["steering", "wheel_left_joint", "wheel_right_joint"]
        return of(kind, header, names, array([0.0] * 3), array([0.0, *it.values]), array([]))
    return of(kind, it.values)


def _rosbag2(path: Path, sent: list[RosMessage]) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Bag2(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        links = {
            topic: bag.add_connection(topic, kind, typestore=store)
            for topic, kind in TOPICS.items()
            if any(it.topic == topic for it in sent)
        }
        for stamp, log_time, it in received(sent):
            data = store.serialize_cdr(message(store, it, stamp), TOPICS[it.topic])
            bag.write(links[it.topic], log_time, data)
    return path


def _rosbag(path: Path, sent: list[RosMessage]) -> Path:
    store, path = get_typestore(Stores.ROS1_NOETIC), path.with_suffix(".bag")
    with Bag1(path) as bag:
        links = {t: bag.add_connection(t, kind, typestore=store) for t, kind in TOPICS.items()}
        for stamp, log_time, it in received(sent):
            data = store.serialize_ros1(message(store, it, stamp, ros1=True), TOPICS[it.topic])
            bag.write(links[it.topic], log_time, data)
    return path


def _ros2_support(path: Path, sent: list[RosMessage]) -> Path:
    store, path = get_typestore(Stores.ROS2_HUMBLE), path.with_suffix(".mcap")
    with path.open("wb") as stream:
        writer = Ros2Support(stream)
        schemas = {
            kind: writer.register_msgdef(kind, store.generate_msgdef(kind, ros_version=2)[0])
            for kind in set(TOPICS.values())
        }
        for stamp, log_time, it in received(sent):
            schema = schemas[TOPICS[it.topic]]
            plain = message(store, it, stamp, array=list)
            writer.write_message(it.topic, schema, plain, log_time, log_time)
        writer.finish()
    return path


def _foxglove(path: Path, sent: list[RosMessage]) -> Path:
    store, path, context = get_typestore(Stores.ROS2_HUMBLE), path.with_suffix(".mcap"), Context()
    channels = {
        topic: Channel(
            topic,
            schema=Schema(
                name=kind, encoding="ros2msg", data=store.generate_msgdef(kind, ros_version=2)[0].encode()
            ),
            message_encoding="cdr",
            context=context,
        )
        for topic, kind in TOPICS.items()
    }
    writer = open_mcap(path, context=context)
    for stamp, log_time, it in received(sent):
        data = store.serialize_cdr(message(store, it, stamp), TOPICS[it.topic])
        channels[it.topic].log(bytes(data), log_time=log_time)
    writer.close()
    return path
