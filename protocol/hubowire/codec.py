"""Encoding of messages to payload bytes, and decoding."""

import struct
from dataclasses import dataclass
from functools import cache
from typing import Any

from hubowire.messages import MESSAGES, AnyMessage, Hello, Message, wire_fields


class PayloadError(ValueError):
    """A payload is too short for its message, or a value does not fit its field."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Byte layout of a message: a fixed part, then at most one counted table.

    Attributes
    ----------
    names : names of all fields.
    fixed : `struct` of the fixed part, which ends in the count of the table, if any.
    widths : number of values of each field of the fixed part.
    strings : (index among the packed values, length) of each byte string.
    rows : `struct` of one row of the table, or None.
    """

    names: tuple[str, ...]
    fixed: struct.Struct
    widths: tuple[int, ...]
    strings: tuple[tuple[int, int], ...]
    rows: struct.Struct | None


def payload_layout(message: type[Message]) -> Layout:
    """Return the byte layout of a message class, little-endian without padding.

    Raise TypeError if a field follows a counted table.
    """
    key: Any = message
    return _layout(key)


@cache
def _layout(message: Any) -> Layout:
    """Build the layout of a message class; cached."""
    table = wire_fields(message)
    if any(row.is_table for row in table[:-1]):
        raise TypeError(f"{message.__name__}: a counted table must be the last field")
    code, rows = "<", None
    widths: list[int] = []
    strings: list[tuple[int, int]] = []
    for row in table:
        if row.is_table:
            code += "B"
            rows = struct.Struct("<" + row.row_type)
            continue
        code += row.type
        if row.type.endswith("s"):
            strings.append((sum(widths), int(row.type[:-1])))
        widths.append(1 if row.type.endswith("s") else int(row.type[:-1] or 1))
    names = tuple(row.name for row in table)
    return Layout(names, struct.Struct(code), tuple(widths), tuple(strings), rows)


def encode(message: Message) -> bytes:
    """Return the payload of a message.

    Raise PayloadError if a value does not fit its wire type.
    """
    name = type(message).__name__
    layout = payload_layout(type(message))
    values: list[Any] = []
    try:
        for field, width in zip(layout.names, layout.widths, strict=False):
            value = getattr(message, field)
            values += value if width > 1 else [value]
        for index, length in layout.strings:
            # struct would silently truncate or pad it.
            if len(values[index]) != length:
                raise PayloadError(f"{name}: {len(values[index])} bytes where {length} are needed")
        if layout.rows is None:
            return layout.fixed.pack(*values)
        rows = getattr(message, layout.names[-1])
        return layout.fixed.pack(*values, len(rows)) + b"".join(layout.rows.pack(*row) for row in rows)
    except (struct.error, TypeError) as error:
        raise PayloadError(f"{name}: {error}") from None


_BY_TYPE = {message.type_id: (message, payload_layout(message)) for message in MESSAGES}


def decode(type_id: int, payload: bytes) -> AnyMessage | None:
    """Return the message of a payload; None for an unknown type.

    Bytes after the last known field belong to a newer version and are ignored. Raise PayloadError if the
    payload is too short.
    """
    if type_id not in _BY_TYPE:
        return None
    message, layout = _BY_TYPE[type_id]
    need = layout.fixed.size
    if len(payload) < need:
        raise PayloadError(f"{message.__name__}: needs {need} bytes, {len(payload)} came")
    flat = layout.fixed.unpack_from(payload)
    values: list[Any] = []
    position = 0
    for width in layout.widths:
        values.append(flat[position] if width == 1 else flat[position : position + width])
        position += width
    if layout.rows is not None:
        count = flat[-1]
        end = need + count * layout.rows.size
        if len(payload) < end:
            raise PayloadError(f"{message.__name__}: {count} rows need {end} bytes, {len(payload)} came")
        values.append(tuple(layout.rows.iter_unpack(payload[need:end])))
    decoded: AnyMessage = message(*values)  # type: ignore[assignment]
    return decoded


_IDENTITY = struct.Struct("<I3B")


def hello_identity(payload: bytes) -> tuple[int, tuple[int, int, int]]:
    """Return fingerprint and firmware version of a `Hello` of any version, even an incompatible one.

    Raise PayloadError if the payload is too short for both.
    """
    if len(payload) < _IDENTITY.size:
        raise PayloadError(f"{Hello.__name__}: needs {_IDENTITY.size} bytes, {len(payload)} came")
    fingerprint, major, minor, patch = _IDENTITY.unpack_from(payload)
    return fingerprint, (major, minor, patch)
