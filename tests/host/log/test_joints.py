"""Joint velocities of JointState messages."""

import numpy as np
from rosbags.typesys import Stores, get_typestore

from hubodo.log.chunk_reader import parse_messages
from hubodo.log.joints import JointSpeeds
from hubodo.log.message_records import encode_message_record

STORE = get_typestore(Stores.ROS2_HUMBLE)


def joint_state(t, names, velocities):
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](t, 5), "base")
    numbers = np.array(velocities, float)
    message = types["sensor_msgs/msg/JointState"](header, names, np.zeros(len(names)), numbers, np.zeros(0))
    return bytes(STORE.serialize_cdr(message, "sensor_msgs/msg/JointState"))


def test_messages_with_other_joints_in_another_order_are_collected_by_name():
    payloads = [
        joint_state(2, ["l", "right_wheel"], [1.0, 2.0]),
        joint_state(1, ["right_wheel", "arm", "l"], [4.0, 9.0, 3.0]),
        joint_state(3, ["arm"], []),
        joint_state(4, ["l"], [np.nan]),
        b"\x00\x01\x00\x00broken",
    ]
    records = b"".join(encode_message_record(1, k, k, 0, payload) for k, payload in enumerate(payloads))
    speeds = JointSpeeds()
    speeds.feed(parse_messages(records), np.arange(len(payloads)))
    t_ns, velocity = speeds.velocity("l")
    assert t_ns.tolist() == [1_000_000_005, 2_000_000_005] and velocity.tolist() == [3.0, 1.0]
    assert speeds.velocity("right_wheel")[1].tolist() == [4.0, 2.0]
    assert speeds.joints_without_velocity == {"arm"} and (speeds.count, speeds.undecodable) == (5, 1)
