"""hubodo's own messages, events and raw bytes, inside messages that every ROS 2 program knows, and out again.

They are std_msgs, so that a program which must know the type of all it copies takes these logs. Earlier logs
have the bytes as they are, encoded as `json` and `hubodo`.
"""

from __future__ import annotations

import struct

from hubodo.log.ros2 import ENCAPSULATION

_LENGTH = struct.Struct("<I")
# Of a UInt8MultiArray: no dimensions, no offset, then the length of the data.
_ARRAY = struct.Struct("<4sIII")


def encode_string_message(text: str) -> bytes:
    """A std_msgs/String."""
    data = text.encode() + b"\0"
    return ENCAPSULATION + _LENGTH.pack(len(data)) + data


def encode_bytes_message(data: bytes) -> bytes:
    """A std_msgs/UInt8MultiArray without dimensions."""
    return _ARRAY.pack(ENCAPSULATION, 0, 0, len(data)) + data


def decode_string_message(encoding: str, payload: bytes) -> bytes:
    """The JSON of an event; of a damaged message nothing."""
    if encoding != "cdr":
        return payload
    return payload[8 : 8 + _length(payload, 4)].rstrip(b"\0")


def decode_bytes_message(encoding: str, payload: bytes) -> bytes:
    """The bytes that came over a link, or were asked there; of a damaged message nothing."""
    if encoding != "cdr":
        return payload
    return payload[_ARRAY.size : _ARRAY.size + _length(payload, 12)]


def _length(payload: bytes, place: int) -> int:
    return _LENGTH.unpack_from(payload, place)[0] if len(payload) >= place + 4 else 0
