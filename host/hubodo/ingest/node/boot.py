"""What a node's decoder keeps: counts, and of one start of it its scales and where each stream stands."""

from __future__ import annotations

from dataclasses import dataclass, field

from hubodo.ingest.node.clock import TickUnwrapper
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.wire_batch import WireBatch
from hubowire.messages import Health, Hello


@dataclass(slots=True)
class NodeCounts:
    """What has come from a node, and what has not."""

    frames: int = 0
    frames_lost: int = 0
    frames_late: int = 0
    frames_unread: int = 0  # no Hello in time, refused, or a payload shorter than its message
    samples: int = 0
    samples_lost: int = 0
    saturated_batches: int = 0
    gaps: int = 0
    restarts: int = 0


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


def first_sample_ns(boot: Boot, batch: WireBatch, t_ns: int, frames_lost: int) -> int:
    """Return the device time of a batch's first sample, in ns on the unbroken scale.

    The frames lost before the batch bound that time from below.
    """
    tail = boot.tail
    if tail is None:
        return boot.ticks.unwrap(batch.t_us, t_ns) * 1000
    period_ns = min(batch.period_ns or tail.period_ns, tail.period_ns)
    counted_ns = tail.next_device_ns + frames_lost * batch.samples * period_ns
    return boot.ticks.unwrap(batch.t_us, t_ns, counted_ns // 1000) * 1000


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
