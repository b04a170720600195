"""Tables of roles: headings, truth, twists, joints of several publishers, messages without a stamp."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.number_recording import InputFormat
from hubodo.log.roles import TopicSelection

STORE = get_typestore(Stores.ROS2_HUMBLE)
T0, COUNT, PERIOD = 1_700_000_000_000_000_000, 30, 100_000_000
YAW = np.linspace(2.5, 4.5, COUNT)


def ros_message(kind: str, *values):
    return STORE.types[kind](*values)


def vector(x=0.0, y=0.0, z=0.0):
    return ros_message("geometry_msgs/msg/Vector3", x, y, z)


def header(k: int, *, stamped: bool = True):
    ns = T0 + k * PERIOD if stamped else 0
    return ros_message(
        "std_msgs/msg/Header", ros_message("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9), "f"
    )


def orientation(k: int, roll: float = 0.0):
    """Return an orientation with yaw and roll, where yaw is not given by z alone."""
    turn = Rotation.from_euler("ZX", [YAW[k], roll]).as_quat()
    return ros_message("geometry_msgs/msg/Quaternion", *map(float, turn))


def imu(k: int, known: float = 0.01):
    covariance = np.diag([0.0 if known > 0 else -1.0, 0.0, max(known, 0.0)]).ravel()
    return ros_message(
        "sensor_msgs/msg/Imu",
        header(k),
        orientation(k, 0.3),
        covariance,
        vector(),
        np.zeros(9),
        vector(),
        np.zeros(9),
    )


def odometry(k: int):
    pose = ros_message(
        "geometry_msgs/msg/Pose", ros_message("geometry_msgs/msg/Point", float(k), 2.0, 5.0), orientation(k)
    )
    twist = ros_message("geometry_msgs/msg/Twist", vector(1.0), vector(z=0.5))
    return ros_message(
        "nav_msgs/msg/Odometry", header(k), "base",
        ros_message("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
        ros_message("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )  # fmt: skip


def twist(k: int):
    return ros_message(
        "geometry_msgs/msg/TwistStamped",
        header(k),
        ros_message("geometry_msgs/msg/Twist", vector(0.1 * k), vector(z=-1.0)),
    )


def joints(k: int):
    """Return messages of two publishers in turn, one per wheel; one value of the right one is missing."""
    kind = "sensor_msgs/msg/JointState"
    if k % 3 == 2:
        return ros_message(kind, header(k), ["arm"], np.ones(1), np.zeros(0), np.zeros(0))
    name, speed = (["l_wheel"], 0.5 * k) if k % 3 else (["r_wheel"], np.nan if k == 6 else 0.25 * k)
    return ros_message(kind, header(k), name, np.zeros(1), np.array([speed]), np.zeros(0))


def bag(path: Path, **topics) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, make in topics.items():
            kind = make(0).__msgtype__
            link = writer.add_connection("/" + topic, kind, typestore=STORE)
            for k in range(COUNT):
                writer.write(link, T0 + k * PERIOD + 5_000_000, STORE.serialize_cdr(make(k), kind))
    return path


def read(path: Path, **roles):
    return read_log(
        path, input_format=InputFormat(topic_selection=TopicSelection(explicit=roles, wheel_radius=0.5))
    )


def test_a_heading_is_the_yaw_of_an_orientation_with_its_sigma(tmp_path):
    path = bag(tmp_path / "bag", compass=imu, odom=odometry)
    heading = read(path, heading="/compass").heading
    np.testing.assert_allclose(np.exp(1j * heading["heading"]), np.exp(1j * YAW), atol=1e-12)
    assert np.ptp(heading["heading"]) == pytest.approx(2.0)
    assert heading["sigma"] == pytest.approx(0.1)
    other = read(path, heading="odom").heading
    np.testing.assert_allclose(np.exp(1j * other["heading"]), np.exp(1j * YAW), atol=1e-12)
    assert "sigma" not in other
    assert read(path).heading is None


def test_an_imu_without_orientation_gives_no_heading(tmp_path):
    path = bag(tmp_path / "bag", compass=lambda k: imu(k, -1.0))
    with pytest.raises(InputError, match="no orientation"):
        read(path, heading="/compass")


def test_one_odometry_may_be_truth_and_a_twist_the_reference(tmp_path):
    path = bag(tmp_path / "bag", odom=odometry, speed=twist)
    tables = read(path, truth="/odom", reference="/speed")
    assert tables.truth["x"].tolist() == list(map(float, range(COUNT)))
    np.testing.assert_allclose(np.exp(1j * tables.truth["heading"]), np.exp(1j * YAW), atol=1e-12)
    assert tables.reference["speed"] == pytest.approx(0.1 * np.arange(COUNT))
    assert set(tables.reference["yaw_rate"]) == {-1.0}
    with pytest.raises(InputError, match="could each be reference"):
        read(path)


def test_wheels_of_different_publishers_are_resampled_at_the_times_of_the_left_one(tmp_path):
    tables = read(bag(tmp_path / "bag", joint_states=joints))
    left = np.arange(1, COUNT, 3)
    np.testing.assert_allclose(tables.wheels.t, (left[left <= 27]) / 10, atol=1e-9)
    assert tables.wheels["left"] == pytest.approx(0.5 * 0.5 * left[left <= 27])
    assert tables.wheels["right"] == pytest.approx(0.5 * 0.25 * left[left <= 27])


def test_a_message_without_a_stamp_has_the_time_of_recording(tmp_path):
    def fix(k: int):
        status = ros_message("sensor_msgs/msg/NavSatStatus", 0 if k else -1, 1)
        return ros_message(
            "sensor_msgs/msg/NavSatFix",
            header(k, stamped=False),
            status,
            47.0,
            8.0,
            400.0 + k,
            np.zeros(9),
            0,
        )

    tables = read(bag(tmp_path / "bag", fix=fix))
    assert tables.t_zero_ns == T0 + 5_000_000
    assert tables.gnss.t[:2] == pytest.approx([0.1, 0.2])
    assert len(tables.gnss) == COUNT - 1
    assert "sigma" not in tables.gnss
