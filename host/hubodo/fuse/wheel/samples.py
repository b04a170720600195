"""Samples of a node as the wheel filter takes them, one by one and in blocks."""

from __future__ import annotations

from dataclasses import dataclass

from hubodo.arrays import Array
from hubodo.recording import Table


@dataclass(frozen=True, slots=True)
class WheelSample:
    """One sample of a node. t: s on the log's clock; gyro: rad/s, accel: m/s², node axes, finite.

    beyond_range: 1.0 where a second accelerometer replaced saturated values, else 0.0.
    """

    node: str
    t: float
    gyro: tuple[float, float, float]
    accel: tuple[float, float, float]
    beyond_range: float = 0.0


BEYOND_RANGE = "beyond_range"
"""Column of a node's table with `WheelSample.beyond_range`; missing if it is always 0."""

SampleBlock = tuple[Array, Array, Array] | tuple[Array, Array, Array, Array]
"""Samples of a node: t (N,) s, gyro (N, 3) rad/s, accel (N, 3) m/s², and optionally `BEYOND_RANGE` (N,)."""


def sample_block(table: Table) -> SampleBlock:
    """Return the samples of a node's table for `WheelFilter.handle_many`."""
    samples = table.t, table.gyro, table.accel
    return (*samples, table[BEYOND_RANGE]) if BEYOND_RANGE in table else samples
