"""Messages to payload bytes and back."""

import struct
from dataclasses import dataclass
from functools import cache
from typing import Any

from hubowire.messages import MESSAGES, AnyMessage, Hello, Message, wire_fields


class PayloadError(ValueError):
    """A payload too short for its message, or a value that does not fit its field."""


@dataclass(frozen=True, slots=True)
class Layout:
    """How the fields of one message lie: the fixed part, then at most one counted table.

    names: all fields. widths: values per field of the fixed part. strings: (place among the packed values,
    length) of each byte string. The fixed part ends in the table's count where there is a table.
    """

    names: tuple[str, ...]
    fixed: struct.Struct
    widths: tuple[int, ...]
    strings: tuple[tuple[int, int], ...]
    rows: struct.Struct | None


def layout(message: type[Message]) -> Layout:
    """The byte layout of a message class, little-endian without padding.

    Raises TypeError when a field follows a counted table.
    """
    key: Any = message
    return _layout(key)


@cache
def _layout(message: Any) -> Layout:
    table = wire_fields(message)
    if any(row.repeats for row in table[:-1]):
        raise TypeError(f"{message.__name__}: a counted table must be the last field")
    code, rows = "<", None
    widths: list[int] = []
    strings: list[tuple[int, int]] = []
    for row in table:
        if row.repeats:
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
    """The payload of a message.

    Raises PayloadError when a value does not fit its wire type.
    """
    name = type(message).__name__
    shape = layout(type(message))
    values: list[Any] = []
    try:
        for field, width in zip(shape.names, shape.widths, strict=False):
            value = getattr(message, field)
            values += value if width > 1 else [value]
        for place, length in shape.strings:
            # struct would cut a longer one and pad a shorter one in silence.
            if len(values[place]) != length:
                raise PayloadError(f"{name}: {len(values[place])} bytes where {length} are needed")
        if shape.rows is None:
            return shape.fixed.pack(*values)
        rows = getattr(message, shape.names[-1])
        return shape.fixed.pack(*values, len(rows)) + b"".join(shape.rows.pack(*row) for row in rows)
    except (struct.error, TypeError) as error:
        raise PayloadError(f"{name}: {error}") from None


_BY_TYPE = {message.type_id: (message, layout(message)) for message in MESSAGES}


def decode(type_id: int, payload: bytes) -> AnyMessage | None:
    """The message in a payload; None for a type this table does not know.

    Bytes after the last known field are a newer version's and are passed over.
    Raises PayloadError when the payload is too short.
    """
    if type_id not in _BY_TYPE:
        return None
    message, shape = _BY_TYPE[type_id]
    need = shape.fixed.size
    if len(payload) < need:
        raise PayloadError(f"{message.__name__}: needs {need} bytes, {len(payload)} came")
    flat = shape.fixed.unpack_from(payload)
    values: list[Any] = []
    at = 0
    for width in shape.widths:
        values.append(flat[at] if width == 1 else flat[at : at + width])
        at += width
    if shape.rows is not None:
        count = flat[-1]
        end = need + count * shape.rows.size
        if len(payload) < end:
            raise PayloadError(f"{message.__name__}: {count} rows need {end} bytes, {len(payload)} came")
        values.append(tuple(shape.rows.iter_unpack(payload[need:end])))
    found: Any = message(*values)
    made: AnyMessage = found
    return made


_IDENTITY = struct.Struct("<I3B")


def hello_identity(payload: bytes) -> tuple[int, tuple[int, int, int]]:
    """Fingerprint and firmware version from a `Hello` of any version, also one `decode` cannot read.

    Raises PayloadError when not even these are there.
    """
    if len(payload) < _IDENTITY.size:
        raise PayloadError(f"{Hello.__name__}: needs {_IDENTITY.size} bytes, {len(payload)} came")
    fingerprint, major, minor, patch = _IDENTITY.unpack_from(payload)
    return fingerprint, (major, minor, patch)
