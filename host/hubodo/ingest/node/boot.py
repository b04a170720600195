"""One start of a node: what its frames are read by, and where each of its streams stands."""

from __future__ import annotations

from dataclasses import dataclass, field

from hubodo.ingest.node.clock import TickUnwrapper
from hubodo.ingest.node.gaps import LinkCounts
from hubowire.messages import Health, Hello


@dataclass(slots=True)
class StreamPlace:
    """Where one message type stood at its newest frame."""

    seq: int
    t_ns: int
    link: LinkCounts


@dataclass(slots=True)
class BatchTail:
    """Where the samples stood after the newest batch."""

    next_index: int
    next_device_ns: int
    period_ns: int
    t_ns: int


@dataclass(slots=True)
class Boot:
    """What is true from one start of the node to its next."""

    hello: Hello
    ticks: TickUnwrapper = field(default_factory=TickUnwrapper)
    streams: dict[int, StreamPlace] = field(default_factory=dict)
    tail: BatchTail | None = None
    health: Health | None = None


def samples_lost(tail: BatchTail, index: int, first_ns: int, period_ns: int, overrun: bool) -> int | None:
    """Samples between two batches: exact by number, with the device time telling whole turns of 2^16.

    None where the chip itself lost them for so long that the node began to count anew: then numbers and
    time disagree.
    """
    by_index = (index - tail.next_index) & 0xFFFF
    by_time = (first_ns - tail.next_device_ns) / period_ns
    lost = by_index + 0x10000 * round((by_time - by_index) / 0x10000)
    if overrun and abs(by_time - lost) > 16 + 0.05 * abs(by_time):
        return None
    return max(lost, 0)
