"""Extract joint velocities from JointState messages, each of which may list other joints in another order."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hubodo.log.chunk_reader import ChunkMessages
from hubodo.log.input_limits import MemoryBudget
from hubodo.units import NS_PER_S

_JOINT_ROW_BYTES = 200  # memory per joint and message: a tuple of two numbers in a list


@dataclass
class JointSpeeds:
    """A collector of joint velocities of one topic.

    Attributes
    ----------
    budget : memory budget for the rows.
    rows : joint name -> list of (time in ns, velocity in rad/s).
    joints_without_velocity : joints in messages that contain positions only.
    count : messages received.
    undecodable : messages whose bytes do not match the type.
    """

    budget: MemoryBudget | None = None
    rows: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    joints_without_velocity: set[str] = field(default_factory=set)
    count: int = 0
    undecodable: int = 0

    def feed(self, messages: ChunkMessages, indices: NDArray[np.intp]) -> None:
        """Decode the messages with these indices."""
        published = messages.headers["publish_time"][indices].tolist()
        for i, t_ns in zip(indices.tolist(), published, strict=True):
            self.count += 1
            try:
                stamp, names, speeds = _parse_joint_state(messages.payload(i))
            except (struct.error, ValueError):
                self.undecodable += 1
                continue
            if self.budget is not None:
                self.budget.claim(_JOINT_ROW_BYTES * len(names), "the list of its joint states")
            if not speeds:
                self.joints_without_velocity.update(names)
            for name, speed in zip(names, speeds, strict=False):
                self.rows.setdefault(name, []).append((stamp or t_ns, speed))

    def velocity(self, joint: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return times (N,) in ns, strictly increasing, and finite velocities (N,) in rad/s of a joint."""
        rows = self.rows[joint]
        t_ns = np.array([t for t, _ in rows], np.int64)
        values = np.array([value for _, value in rows])
        finite = np.isfinite(values)
        t_ns, first_rows = np.unique(t_ns[finite], return_index=True)
        return t_ns, values[finite][first_rows]


def _parse_joint_state(payload: bytes) -> tuple[int, tuple[str, ...], tuple[float, ...]]:
    """Return stamp in ns, joint names and velocities. Raises struct.error or ValueError if undecodable."""
    if payload[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError("not plain CDR")
    order = "<" if payload[1] else ">"
    seconds, nanoseconds, size = struct.unpack_from(order + "iII", payload, 4)
    end = 16 + size
    end += -end % 4
    first = end
    (count,) = struct.unpack_from(order + "I", payload, end)
    if count > len(payload):
        raise ValueError(f"claims {count} names")
    end += 4
    for _ in range(count):
        end += -end % 4
        (size,) = struct.unpack_from(order + "I", payload, end)
        end += 4 + size
    names = _decode_names(order, payload[first:end])
    offset, _ = _read_float64_sequence(order, payload, end)
    offset, speeds = _read_float64_sequence(order, payload, offset)
    return seconds * NS_PER_S + nanoseconds, names, speeds


def _read_float64_sequence(order: str, payload: bytes, offset: int) -> tuple[int, tuple[float, ...]]:
    """Read a sequence of float64 at the next aligned offset; return the offset of its end and the values."""
    offset += -offset % 4
    (count,) = struct.unpack_from(order + "I", payload, offset)
    offset += 4
    if not count:
        return offset, ()
    # Alignment counts from the end of the four encapsulation bytes.
    offset += -(offset - 4) % 8
    if offset + 8 * count > len(payload):
        raise ValueError(f"claims {count} numbers")
    return offset + 8 * count, struct.unpack_from(f"{order}{count}d", payload, offset)


@lru_cache(maxsize=64)
def _decode_names(order: str, block: bytes) -> tuple[str, ...]:
    """Decode a sequence of strings."""
    return tuple(_iterate_strings(order, block))


def _iterate_strings(order: str, block: bytes) -> Iterator[str]:
    offset = 4
    while offset < len(block):
        offset += -offset % 4
        (size,) = struct.unpack_from(order + "I", block, offset)
        yield block[offset + 4 : offset + 4 + size].rstrip(b"\0").decode("utf-8", "replace")
        offset += 4 + size
