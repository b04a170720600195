"""Replacement of saturated accelerations in blocks of samples, live and in playback.

Blocks pass at once until one is saturated; that one and all after it wait until the samples of the second
accelerometer around it were received, for up to `MAX_DELAY`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from hubodo.arrays import Array
from hubodo.fuse.range_extension import RangeExtension
from hubodo.log.records import HighGSamples, ImuBlock
from hubodo.log.timebase import to_seconds


class BlockExtension:
    """Blocks of one node that has a second accelerometer.

    Parameters
    ----------
    limit
        m/s² from which on the IMU's accelerometer counts as saturated.
    t_zero_ns
        Host time of t = 0.
    """

    def __init__(self, limit: float, t_zero_ns: int) -> None:
        self._extension, self._t_zero_ns = RangeExtension(limit), t_zero_ns
        self._waiting: deque[tuple[ImuBlock, Array]] = deque()
        self._newest = 0.0

    def add_chip(self, samples: HighGSamples) -> list[ImuBlock]:
        """Add samples of the second accelerometer and return the blocks that waited for them."""
        self._extension.add_chip(to_seconds(samples.t_ns, self._t_zero_ns), samples.accel)
        return self._release()

    def add_block(self, block: ImuBlock) -> list[ImuBlock]:
        """Add a block and return those that do not wait."""
        t = to_seconds(block.t_ns, self._t_zero_ns)
        self._extension.add_imu(t, block.accel)
        self._newest = float(t[-1])
        self._waiting.append((block, t))
        return self._release()

    def finish(self) -> list[ImuBlock]:
        """Return all blocks that wait."""
        return [self._extend(*self._waiting.popleft()) for _ in range(len(self._waiting))]

    def _release(self) -> list[ImuBlock]:
        released = []
        while self._waiting:
            block, t = self._waiting[0]
            if self._extension.is_awaited(t, block.accel, self._newest):
                break
            self._waiting.popleft()
            released.append(self._extend(block, t))
        if not self._waiting:
            self._extension.learn()
        return released

    def _extend(self, block: ImuBlock, t: Array) -> ImuBlock:
        accel, replaced = self._extension.extend(t, block.accel)
        return replace(block, accel=accel, beyond_range=replaced) if replaced.any() else block
