"""Host times of one stream of a node, with corrections of the clock applied by slewing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.node.clock import ClockSync

Times = NDArray[np.int64]

_SLEW_RATIO = 10_000
"""ns of the stream per 1 ns of correction: 100 ppm, the tolerance of a crystal."""
_MAX_SLEW_NS = 2_000_000


class SlewedTimes:
    """Strictly increasing host times; corrections up to 2 ms are slewed, larger ones applied at once.

    A step between two samples would look like a change of the sample interval; but an error above 2 ms
    between two nodes would degrade their fusion.
    """

    def __init__(self, clock: ClockSync) -> None:
        self._clock = clock
        self._clock_revision = self._clock_resets = -1
        self._last: tuple[int, int] | None = None  # device and host time of the newest sample
        self._correction_start_ns = self._correction_ns = (
            0  # start (device time) and size of the correction being slewed
        )

    def to_host_ns(self, device_ns: Times) -> Times:
        """Return strictly increasing host times (N,) ns of unwrapped device times (N,) ns."""
        if not len(device_ns):
            return device_ns
        if self._clock.revision != self._clock_revision:
            self._start_correction()
        steps = np.arange(len(device_ns))
        level = self._clock.to_host_ns(device_ns) - steps
        if self._correction_ns:
            slewed = np.maximum(device_ns - self._correction_start_ns, 0) // _SLEW_RATIO
            level += np.sign(self._correction_ns) * np.maximum(abs(self._correction_ns) - slewed, 0)
        if self._last is not None:
            level[0] = max(int(level[0]), self._last[1] + 1)
        host_ns: Times = np.maximum.accumulate(level) + steps
        self._last = int(device_ns[-1]), int(host_ns[-1])
        return host_ns

    def _start_correction(self) -> None:
        same_start, self._clock_resets = self._clock.resets == self._clock_resets, self._clock.resets
        self._clock_revision, self._correction_ns = self._clock.revision, 0
        if self._last is None or not same_start:
            return
        self._correction_start_ns, before = self._last
        correction_ns = before - int(
            self._clock.to_host_ns(np.array([self._correction_start_ns], np.int64))[0]
        )
        self._correction_ns = correction_ns if abs(correction_ns) <= _MAX_SLEW_NS else 0
