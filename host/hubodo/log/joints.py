"""Messages of type JointState to the speeds of joints; each may name other joints, in another order."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hubodo.log.chunk_reader import Messages
from hubodo.log.input_limits import MemoryBudget
from hubodo.units import NS_PER_S

_ROW_BYTES = 200  # of memory per joint and message: a tuple of two numbers in a list, at first its name


@dataclass
class JointSpeeds:
    """Collects one topic. rows: by joint, times in ns and velocities in rad/s; stays: of joints without one.

    budget: for the rows. undecodable: messages whose bytes do not fit the type.
    """

    budget: MemoryBudget | None = None
    rows: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    stays: set[str] = field(default_factory=set)
    count: int = 0
    undecodable: int = 0

    def feed(self, messages: Messages, chosen: NDArray[np.intp]) -> None:
        """Take in the messages with these indices."""
        published = messages.heads["publish_time"][chosen].tolist()
        for i, t_ns in zip(chosen.tolist(), published, strict=True):
            self.count += 1
            try:
                stamp, names, speeds = _parse(messages.payload(i))
            except (struct.error, ValueError):
                self.undecodable += 1
                continue
            if self.budget is not None:
                self.budget.claim(_ROW_BYTES * len(names), "the list of its joint states")
            if not speeds:
                self.stays.update(names)
            for name, speed in zip(names, speeds, strict=False):
                self.rows.setdefault(name, []).append((stamp or t_ns, speed))

    def table(self, joint: str) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Times (N,) ns, strictly increasing, and velocities (N,) rad/s of a joint, where it is a number."""
        rows = self.rows[joint]
        t_ns = np.array([t for t, _ in rows], np.int64)
        values = np.array([value for _, value in rows])
        good = np.isfinite(values)
        t_ns, places = np.unique(t_ns[good], return_index=True)
        return t_ns, values[good][places]


def _parse(payload: bytes) -> tuple[int, tuple[str, ...], tuple[float, ...]]:
    """Stamp in ns, joint names, velocities. Raises struct.error or ValueError for what is no JointState."""
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
    names = _names(order, payload[first:end])
    place, _ = _sequence(order, payload, end)
    place, speeds = _sequence(order, payload, place)
    return seconds * NS_PER_S + nanoseconds, names, speeds


def _sequence(order: str, payload: bytes, place: int) -> tuple[int, tuple[float, ...]]:
    """A sequence of float64 that begins at or behind place; where it ends."""
    place += -place % 4
    (count,) = struct.unpack_from(order + "I", payload, place)
    place += 4
    if not count:
        return place, ()
    # Alignment counts from behind the four bytes of the encapsulation.
    place += -(place - 4) % 8
    if place + 8 * count > len(payload):
        raise ValueError(f"claims {count} numbers")
    return place + 8 * count, struct.unpack_from(f"{order}{count}d", payload, place)


@lru_cache(maxsize=64)
def _names(order: str, block: bytes) -> tuple[str, ...]:
    """The names of a sequence of strings."""
    return tuple(_texts(order, block))


def _texts(order: str, block: bytes) -> Iterator[str]:
    place = 4
    while place < len(block):
        place += -place % 4
        (size,) = struct.unpack_from(order + "I", block, place)
        yield block[place + 4 : place + 4 + size].rstrip(b"\0").decode("utf-8", "replace")
        place += 4 + size
