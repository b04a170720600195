"""Encode and decode hubodo's own messages (events, raw bytes) as std_msgs.

std_msgs let programs that must know the type of every message copy these logs. Earlier logs contain the bare
bytes, with the encodings `json` and `hubodo`.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable

from hubodo.log.cdr_layouts import ENCAPSULATION
from hubodo.recording import Event

_LENGTH = struct.Struct("<I")
# Header of a UInt8MultiArray: encapsulation, no dimensions, no offset, length of the data.
_ARRAY = struct.Struct("<4sIII")


def encode_string_message(text: str) -> bytes:
    """Encode text as a std_msgs/String."""
    data = text.encode() + b"\0"
    return ENCAPSULATION + _LENGTH.pack(len(data)) + data


def encode_bytes_message(data: bytes) -> bytes:
    """Encode bytes as a std_msgs/UInt8MultiArray without dimensions."""
    return _ARRAY.pack(ENCAPSULATION, 0, 0, len(data)) + data


def decode_string_message(encoding: str, payload: bytes) -> bytes:
    """Return the text of an event message (JSON); b"" if damaged."""
    if encoding != "cdr":
        return payload
    return payload[8 : 8 + _read_length(payload, 4)].rstrip(b"\0")


def decode_bytes_message(encoding: str, payload: bytes) -> bytes:
    """Return the bytes of a raw frame or clock request; b"" if damaged."""
    if encoding != "cdr":
        return payload
    return payload[_ARRAY.size : _ARRAY.size + _read_length(payload, 12)]


def _read_length(payload: bytes, offset: int) -> int:
    return _LENGTH.unpack_from(payload, offset)[0] if len(payload) >= offset + 4 else 0


def parse_events(payloads: Iterable[bytes]) -> tuple[tuple[Event, ...], tuple[str, ...]]:
    """Return events sorted by time, and a note for each payload that cannot be decoded."""
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
            notes.append(f"an event cannot be decoded: {payload[:60]!r}")
    return tuple(sorted(events, key=lambda event: event.t_ns)), tuple(notes)


def _reject_constant(word: str) -> float:
    raise ValueError(f"{word} is not a JSON number")


def _parse_finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _reject_constant(text)
