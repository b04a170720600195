"""hubodo's own messages, events and raw bytes, inside messages that every ROS 2 program knows, and out again.

They are std_msgs, so that a program which must know the type of all it copies takes these logs. Earlier logs
have the bytes as they are, encoded as `json` and `hubodo`.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable

from hubodo.log.ros2 import ENCAPSULATION
from hubodo.recording import Event

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


def parse_events(payloads: Iterable[bytes]) -> tuple[tuple[Event, ...], tuple[str, ...]]:
    """Events in order of time from their messages, and a note on each that cannot be understood."""
    events, notes = [], []
    for payload in payloads:
        try:
            body = json.loads(payload, parse_constant=_reject_constant, parse_float=_parse_finite)
            events.append(
                Event(
                    int(body["t_ns"]),
                    str(body["kind"]),
                    str(body["source"]),
                    str(body["text"]),
                    dict(body["data"]),
                )
            )
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            notes.append(f"an event cannot be understood: {payload[:60]!r}")
    return tuple(sorted(events, key=lambda event: event.t_ns)), tuple(notes)


def _reject_constant(word: str) -> float:
    raise ValueError(f"{word} is no number of JSON")


def _parse_finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _reject_constant(text)
