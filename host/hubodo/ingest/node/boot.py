"""State of a node's decoder: counters, and for one boot the Hello and the position in each stream."""

from __future__ import annotations

from dataclasses import dataclass, field

from hubodo.ingest.node.clock import TickUnwrapper
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.wire_batch import WireBatch
from hubowire.messages import Health, Hello


@dataclass(slots=True)
class NodeCounts:
    """Numbers of frames and samples received from a node, lost, or not decoded."""

    frames: int = 0
    frames_lost: int = 0
    frames_late: int = 0
    frames_undecoded: int = 0  # no Hello in time, wire mismatch, or a payload shorter than its message
    samples: int = 0
    samples_lost: int = 0
    saturated_batches: int = 0
    gaps: int = 0
    restarts: int = 0


@dataclass(slots=True)
class StreamState:
    """State of one message type at its newest frame: sequence number, arrival time and link counters."""

    seq: int
    t_ns: int
    link_counts: LinkCounts


@dataclass(slots=True)
class BatchTail:
    """Sample number and device time expected after the newest batch."""

    next_index: int
    next_device_ns: int
    period_ns: int
    t_ns: int


@dataclass(slots=True)
class BootState:
    """State of a node from one boot to the next."""

    hello: Hello
    ticks: TickUnwrapper = field(default_factory=TickUnwrapper)
    streams: dict[int, StreamState] = field(default_factory=dict)
    tail: BatchTail | None = None
    health: Health | None = None


def unwrap_first_sample(boot: BootState, batch: WireBatch, t_ns: int, frames_lost: int) -> int:
    """Return the unwrapped device time of a batch's first sample, ns.

    The number of frames lost before the batch bounds that time from below.
    """
    tail = boot.tail
    if tail is None:
        return boot.ticks.unwrap(batch.t_us, t_ns) * 1000
    period_ns = min(batch.period_ns or tail.period_ns, tail.period_ns)
    earliest_ns = tail.next_device_ns + frames_lost * batch.sample_count * period_ns
    return boot.ticks.unwrap(batch.t_us, t_ns, earliest_ns // 1000) * 1000


def count_lost_samples(
    tail: BatchTail, index: int, first_ns: int, period_ns: int, overrun: bool, rate_changed: bool = False
) -> int | None:
    """Return the number of samples lost between two batches.

    Sample numbers give it modulo 2^16, and device time gives the multiple of 2^16. After a change of the rate
    sample numbers alone count: a node that was asleep took no samples in between. Return None if numbers and
    time disagree after an overrun of the chip's FIFO, because the node then restarts its sample numbers.
    """
    by_index = (index - tail.next_index) & 0xFFFF
    if rate_changed:
        return by_index
    by_time = (first_ns - tail.next_device_ns) / period_ns
    lost = by_index + 0x10000 * round((by_time - by_index) / 0x10000)
    if overrun and abs(by_time - lost) > 16 + 0.05 * abs(by_time):
        return None
    return max(lost, 0)
