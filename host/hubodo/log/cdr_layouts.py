"""CDR byte layouts of ROS 2 messages, derived from their definitions.

CDR as ROS 2 writes it: 4 bytes of encapsulation (little-endian plain CDR), then the fields in order, each
aligned to its own size counted from the end of those 4 bytes. If all strings and sequences of a channel have
constant length, every message has the same size and numpy encodes and decodes whole batches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hubodo.log import ros2
from hubodo.safe_text import json_text

ENCAPSULATION = b"\x00\x01\x00\x00"
_PRIMITIVES: Mapping[str, str] = {
    "bool": "b1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}


@dataclass(frozen=True)
class CdrLayout:
    """The byte layout of one message type for given string and sequence lengths.

    Attributes
    ----------
    dtype : structured, little-endian; its itemsize is the message with encapsulation. Field names are dotted
        paths (`header.stamp.sec`); a group of float64 also has its own name (`angular_velocity`, shape (3,)).
    template : () record of that dtype with encapsulation, strings and lengths set, all else zero.
    """

    dtype: np.dtype[np.void]
    template: np.ndarray[tuple[()], np.dtype[np.void]]


class _LayoutBuilder:
    """A builder that places the fields of a definition; `length_of(path, position)` returns lengths."""

    def __init__(self, length_of: Callable[[str, int], int], byte_order: str = "<") -> None:
        self.length_of, self.byte_order = length_of, byte_order
        self.position = len(ENCAPSULATION)
        self.names: list[str] = []
        self.formats: list[object] = []
        self.offsets: list[int] = []
        self.lengths: dict[str, int] = {}

    def add_field(self, path: str, code: str, count: int = 1, *, is_array: bool = False) -> None:
        size = int(code[1:])
        if count:
            self.position += -(self.position - len(ENCAPSULATION)) % size
        self._record_field(
            path, (self.byte_order + code, (count,)) if is_array else self.byte_order + code, self.position
        )
        self.position += size * count

    def _record_field(self, path: str, form: object, offset: int) -> None:
        self.names.append(path)
        self.formats.append(form)
        self.offsets.append(offset)

    def _add_length(self, path: str) -> int:
        self.add_field(path + ".length", "u4")
        length = self.lengths[path + ".length"] = self.length_of(path, self.position - 4)
        return length

    def add_message(self, name: str, prefix: str) -> None:
        for field in ros2.message_fields(name):
            path = prefix + field.name
            count = self._add_length(path) if field.count is None else field.count
            if field.type == "string":
                length = self._add_length(path)
                self._record_field(path, f"V{length}", self.position)
                self.position += length
            elif field.type in _PRIMITIVES:
                self.add_field(path, _PRIMITIVES[field.type], count, is_array=field.is_array)
            else:
                for i in range(count):
                    self._add_group(field.type, f"{path}[{i}]" if field.is_array else path)

    def _add_group(self, name: str, path: str) -> None:
        first = len(self.names)
        self.add_message(name, path + ".")
        if all(form == self.byte_order + "f8" for form in self.formats[first:]):
            self._record_field(
                path, (self.byte_order + "f8", (len(self.names) - first,)), self.offsets[first]
            )

    def dtype(self) -> np.dtype[np.void]:
        return np.dtype(
            {
                "names": ["encapsulation", *self.names],
                "formats": ["<u4", *self.formats],
                "offsets": [0, *self.offsets],
                "itemsize": self.position,
            }
        )


def cdr_layout(
    name: str, texts: Mapping[str, bytes] | None = None, lengths: Mapping[str, int] | None = None
) -> CdrLayout:
    """Return the byte layout of one message type.

    texts: value of each string field by path, without the terminating zero. lengths: number of elements of
    each sequence. Raises KeyError if a string or sequence is missing.
    """
    closed = {path: text + b"\x00" for path, text in (texts or {}).items()}
    known = {**(lengths or {}), **{path: len(text) for path, text in closed.items()}}
    builder = _LayoutBuilder(lambda path, _: known[path])
    builder.add_message(name, "")
    template = np.zeros((), builder.dtype())
    template["encapsulation"] = int.from_bytes(ENCAPSULATION, "little")
    for path, length in builder.lengths.items():
        template[path] = length
    for path, text in closed.items():
        if path in builder.names:
            template[path] = np.void(text)
    return CdrLayout(builder.dtype(), template)


@dataclass(frozen=True)
class ReceivedLayout:
    """The layout of a received message.

    dtype: structure of the message. lengths: value of each length field, which other messages of this layout
    share.
    """

    dtype: np.dtype[np.void]
    lengths: Mapping[str, int]
    encapsulation: int

    def element_count(self, path: str) -> int:
        """Return the number of elements of a field."""
        assert self.dtype.fields is not None
        return math.prod(self.dtype.fields[path][0].shape)

    def read_string(self, payload: bytes, path: str) -> str:
        """Return a string field of a message of this layout."""
        assert self.dtype.fields is not None
        part, offset = self.dtype.fields[path][:2]
        return payload[offset : offset + part.itemsize].rstrip(b"\0").decode("utf-8", "replace")


def infer_layout(name: str, payload: bytes) -> ReceivedLayout:
    """Infer the layout of one message from the string and sequence lengths in its bytes.

    Raises ValueError for an encapsulation other than plain CDR and for lengths that do not match the payload.
    """
    if payload[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError(f"encapsulation {payload[:4].hex()} is not plain CDR")
    order: Literal["little", "big"] = "little" if payload[1] else "big"

    def length_of(path: str, position: int) -> int:
        length = int.from_bytes(payload[position : position + 4], order)
        if position + 4 + length > len(payload):
            raise ValueError(f"{path} claims {length} elements in a message of {len(payload)} bytes")
        return length

    builder = _LayoutBuilder(length_of, "<" if payload[1] else ">")
    builder.add_message(name, "")
    if not builder.position <= len(payload) <= builder.position + 3:
        raise ValueError(f"message of {len(payload)} bytes should have {builder.position}")
    return ReceivedLayout(builder.dtype(), builder.lengths, int.from_bytes(payload[:4], "little"))


def stamped_layout(name: str, frame_id: str, child_frame_id: str = "") -> CdrLayout:
    """Return the layout of a message with one header (or one transform) and constant frame names.

    The cells, location and serial number of a BatteryState stay empty.
    """
    prefix = "transforms[0]." if name == ros2.TF else ""
    texts = {
        prefix + "header.frame_id": frame_id.encode(),
        prefix + "child_frame_id": child_frame_id.encode(),
        "location": b"",
        "serial_number": b"",
    }
    return cdr_layout(name, texts, {"transforms": 1, "cell_voltage": 0, "cell_temperature": 0})


def columns_layout(names: Sequence[str]) -> CdrLayout:
    """Return the layout of a row of numbers as a Float64MultiArray with the column names as label.

    The label keeps the names in copies by other programs, which drop the metadata of channels.
    """
    label, count = json_text(list(names)).encode(), len(names)
    row_layout = cdr_layout(
        ros2.FLOAT64_ARRAY, {"layout.dim[0].label": label}, {"layout.dim": 1, "data": count}
    )
    row_layout.template["layout.dim[0].size"] = count
    row_layout.template["layout.dim[0].stride"] = count
    return row_layout
