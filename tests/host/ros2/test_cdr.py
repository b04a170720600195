"""Single messages against the encoder of Cyclone DDS, whose types were written by hand."""

import dataclasses
import sys
from pathlib import Path

import pytest

import wanted
from hubodo.log import ros2
from hubodo.ros2.cdr import decode_message, encode_message

wanted.module("cyclonedds")
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "fakes"))
from ros2_publisher import build  # noqa: E402

MESSAGES = {
    ros2.IMU: ("imu", {"gyro": [0.1, -2.5, 3.0], "accel": [9.8, 0.0, -1e-9], "variances": [1e-4, 1e-2]}),
    ros2.JOINT_STATE: ("joints", {"names": ["l", "right_wheel"], "velocity": [1.5, -2.25]}),
    ros2.TWIST_STAMPED: ("twist", {"speed": 1.25, "yaw_rate": -0.5}),
    ros2.NAV_SAT_FIX: ("fix", {"latitude": 47.4, "longitude": -8.5, "altitude": 3.0, "sigma": 2.0}),
}


def plain(value):
    """Return a message as dictionaries and tuples."""
    if dataclasses.is_dataclass(value):
        return {name: plain(getattr(value, name)) for name in value.__annotations__}
    return tuple(map(plain, value)) if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("message_type", MESSAGES)
def test_messages_of_another_encoder_are_decoded_and_encoded_equally(message_type):
    kind, values = MESSAGES[message_type]
    message = build(kind, values, 1_700_000_000_123_456_789)
    payload = message.serialize(use_version_2=False)
    assert decode_message(message_type, payload) == plain(message)
    assert encode_message(message_type, plain(message))[4:] == payload[4 : len(payload)].rstrip(b"\0").ljust(
        len(encode_message(message_type, plain(message))) - 4, b"\0"
    )


@pytest.mark.parametrize("message_type", MESSAGES)
def test_truncated_and_altered_messages_raise_value_error_alone(message_type):
    kind, values = MESSAGES[message_type]
    payload = build(kind, values, 0).serialize(use_version_2=False)
    for end in range(len(payload) - 8):
        with pytest.raises(ValueError):
            decode_message(message_type, payload[:end])
    for position in range(len(payload)):
        altered = payload[:position] + b"\xff" + payload[position + 1 :]
        try:
            decode_message(message_type, altered)
        except ValueError:
            continue
