"""Encode single ROS 2 messages of any length; batches of one layout use `hubodo.log.ros2`."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from hubodo.log import ros2

_CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}


def encode_message(message_type: str, values: Mapping[str, Any]) -> bytes:
    """Encode a message as little-endian CDR; fields without a value are zero or empty.

    values: by field name; of a message within it another mapping, of an array a sequence.
    """
    out = bytearray()
    _encode_fields(message_type, values, out)
    return ros2.ENCAPSULATION + bytes(out)


def _encode_fields(message_type: str, values: Mapping[str, Any], out: bytearray) -> None:
    for field in ros2.message_fields(message_type):
        value = values.get(field.name)
        if not field.is_array:
            _encode_value(field.type, value, out)
            continue
        elements: Sequence[Any] = [None] * (field.count or 0) if value is None else value
        if field.count is None:
            _append("I", len(elements), out)
        elif len(elements) != field.count:
            raise ValueError(f"{field.name} has {len(elements)} elements, not {field.count}")
        for element in elements:
            _encode_value(field.type, element, out)


def _encode_value(field_type: str, value: Any, out: bytearray) -> None:
    if field_type == "string":
        text = (value or "").encode() + b"\0"
        _append("I", len(text), out)
        out += text
    elif field_type in _CODES:
        _append(_CODES[field_type], value or 0, out)
    else:
        _encode_fields(field_type, value or {}, out)


def _append(code: str, value: Any, out: bytearray) -> None:
    """Append a number, aligned to its size."""
    out += bytes(-len(out) % struct.calcsize(code))
    out += struct.pack("<" + code, value)
