"""Host times of one stream of a node, at intervals that stay those of the node's own clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.node.clock import ClockSync

Times = NDArray[np.int64]

_SLEW = 10_000
"""ns of the stream in which 1 ns of a correction is made: 100 ppm, as much as a crystal may be off."""
_STEP_NS = 2_000_000


class SteadyTimes:
    """What becomes known of a clock later corrects the times little by little, or at once beyond 2 ms.

    Two nodes whose times are further apart than that spoil what is made of both; a correction that is made at
    once takes samples together or apart, as if they had been taken faster or slower.
    """

    def __init__(self, clock: ClockSync) -> None:
        self._clock = clock
        self._changes = self._resets = -1
        self._last: tuple[int, int] | None = None  # device and host time of the newest sample
        self._from_ns = self._behind = 0  # the correction to make, and since which device time

    def apply(self, device_ns: Times) -> Times:
        """Unbroken device times (N,) ns to host times (N,) ns, each later than the one before."""
        if not len(device_ns):
            return device_ns
        if self._clock.changes != self._changes:
            self._correct()
        steps = np.arange(len(device_ns))
        level = self._clock.host_ns(device_ns) - steps
        if self._behind:
            made = np.maximum(device_ns - self._from_ns, 0) // _SLEW
            level += np.sign(self._behind) * np.maximum(abs(self._behind) - made, 0)
        if self._last is not None:
            level[0] = max(int(level[0]), self._last[1] + 1)
        host_ns: Times = np.maximum.accumulate(level) + steps
        self._last = int(device_ns[-1]), int(host_ns[-1])
        return host_ns

    def _correct(self) -> None:
        same_start, self._resets = self._clock.resets == self._resets, self._clock.resets
        self._changes, self._behind = self._clock.changes, 0
        if self._last is None or not same_start:
            return
        self._from_ns, before = self._last
        behind = before - int(self._clock.host_ns(np.array([self._from_ns], np.int64))[0])
        self._behind = behind if abs(behind) <= _STEP_NS else 0
