"""Encode and decode single ROS 2 messages of any length; batches of one layout use `hubodo.log.ros2`."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from hubodo.log import cdr_layouts, ros2

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

    values: by field name: a number or text, a mapping for a nested message, or a sequence for an array.
    """
    out = bytearray()
    _encode_fields(message_type, values, out)
    return cdr_layouts.ENCAPSULATION + bytes(out)


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


def decode_message(message_type: str, payload: bytes) -> dict[str, Any]:
    """Return the fields of a message in plain CDR: inverse of `encode_message`.

    Raises ValueError if the bytes do not match the type.
    """
    if payload[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError(f"encapsulation {payload[:4].hex()} is not plain CDR")
    reader = _CdrReader(payload, "<" if payload[1] else ">")
    try:
        return reader.read_fields(message_type)
    except struct.error as error:
        raise ValueError(f"{message_type} in {len(payload)} bytes: {error}") from None


class _CdrReader:
    """Reads values one after another from a message."""

    def __init__(self, payload: bytes, order: str) -> None:
        self._payload, self._order, self._offset = payload, order, len(cdr_layouts.ENCAPSULATION)

    def read_fields(self, message_type: str) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for field in ros2.message_fields(message_type):
            if not field.is_array:
                values[field.name] = self._read_value(field.type)
                continue
            count = self._read_numbers("I", 1)[0] if field.count is None else field.count
            if field.type in _CODES:
                values[field.name] = self._read_numbers(_CODES[field.type], count)
            elif count > len(self._payload):
                raise ValueError(f"{field.name} claims {count} elements in {len(self._payload)} bytes")
            else:
                values[field.name] = tuple(self._read_value(field.type) for _ in range(count))
        return values

    def _read_value(self, field_type: str) -> Any:
        if field_type == "string":
            (size,) = self._read_numbers("I", 1)
            start, self._offset = self._offset, self._offset + size
            if self._offset > len(self._payload):
                raise ValueError(f"a string claims {size} bytes in {len(self._payload)}")
            return self._payload[start : self._offset].rstrip(b"\0").decode("utf-8", "replace")
        if field_type in _CODES:
            return self._read_numbers(_CODES[field_type], 1)[0]
        return self.read_fields(field_type)

    def _read_numbers(self, code: str, count: int) -> tuple[Any, ...]:
        if not count:
            return ()
        size = struct.calcsize(code)
        # Alignment counts from the end of the encapsulation.
        start = self._offset + -(self._offset - len(cdr_layouts.ENCAPSULATION)) % size
        self._offset = start + size * count
        if self._offset > len(self._payload):
            raise ValueError(f"{count} numbers at byte {start} of {len(self._payload)}")
        return struct.unpack_from(f"{self._order}{count}{code}", self._payload, start)
