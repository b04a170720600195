"""Encode message records of a chunk: one as bytes, or many of one layout as rows of an array."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from hubodo.log import cdr_layouts

MESSAGE_HEADER = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
"""Header of each message record: 31 bytes, of which the last 22 count in `length`."""
_MESSAGE_HEADER_STRUCT = struct.Struct("<BQHIqq")
MAX_PENDING_ROWS = 2048
"""Capacity of a row buffer."""


def encode_message_record(channel: int, sequence: int, t_log_ns: int, t_pub_ns: int, payload: bytes) -> bytes:
    """Encode one message as a record of a chunk."""
    header = _MESSAGE_HEADER_STRUCT.pack(
        5, 22 + len(payload), channel, sequence & 0xFFFFFFFF, t_log_ns, t_pub_ns
    )
    return header + payload


class RowBuffer:
    """A buffer of message records of one channel and layout; constant fields are set once.

    The first `n_filled` rows wait for their chunk.
    """

    def __init__(self, channel: int, layout: cdr_layouts.CdrLayout, stamp: str) -> None:
        size = layout.dtype.itemsize
        self.channel = channel
        self.n_filled = 0
        self.record_size = MESSAGE_HEADER.itemsize + size
        self.rows = np.zeros(
            MAX_PENDING_ROWS, np.dtype([*_dtype_fields(MESSAGE_HEADER), ("message", layout.dtype)])
        )
        self.rows["opcode"] = Opcode.MESSAGE
        self.rows["length"] = 22 + size
        self.rows["channel"] = channel
        self.rows["message"] = layout.template
        self.sequence = self.rows["sequence"]
        self.log_time = self.rows["log_time"]
        self.publish_time = self.rows["publish_time"]
        message = self.rows["message"]
        self.seconds = message[stamp + "stamp.sec"] if stamp else None
        self.nanoseconds = message[stamp + "stamp.nanosec"] if stamp else None
        self.field_views: dict[str, NDArray[Any]] = {}

    def field_view(self, path: str) -> NDArray[Any]:
        """Return the array of one message field over all rows; path: dotted, as in `CdrLayout`."""
        view = self.field_views.get(path)
        if view is None:
            view = self.field_views[path] = self.rows["message"][path]
        return view


def _dtype_fields(dtype: np.dtype[Any]) -> Sequence[tuple[str, Any]]:
    return [(name, dtype[name]) for name in dtype.names or ()]
