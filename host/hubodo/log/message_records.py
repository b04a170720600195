"""How messages lie in a chunk: a single one as bytes, many of one layout as rows."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from hubodo.log import ros2

PREFIX = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
"""What stands before the payload of each message record: 31 bytes, of which 22 count in `length`."""
_HEAD = struct.Struct("<BQHIqq")
SLAB = 2048
"""Rows that wait at most."""


def message_record(channel: int, sequence: int, t_log_ns: int, t_pub_ns: int, payload: bytes) -> bytes:
    """A message as a chunk holds it."""
    head = _HEAD.pack(5, 22 + len(payload), channel, sequence & 0xFFFFFFFF, t_log_ns, t_pub_ns)
    return head + payload


class BatchStream:
    """Rows of one channel with messages of one layout; constants are filled in once, the rest per batch.

    The first `filled` rows wait for their chunk.
    """

    def __init__(self, channel: int, layout: ros2.CdrLayout, stamp: str) -> None:
        size = layout.dtype.itemsize
        self.channel = channel
        self.filled = 0
        self.record_size = PREFIX.itemsize + size
        self.rows = np.zeros(SLAB, np.dtype([*_fields(PREFIX), ("message", layout.dtype)]))
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
        self.views: dict[str, NDArray[Any]] = {}

    def view(self, path: str) -> NDArray[Any]:
        view = self.views.get(path)
        if view is None:
            view = self.views[path] = self.rows["message"][path]
        return view


def _fields(dtype: np.dtype[Any]) -> Sequence[tuple[str, Any]]:
    return [(name, dtype[name]) for name in dtype.names or ()]
