"""Host times of one stream of a node, with corrections of the clock applied by slewing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.node.clock import ClockSync
from hubodo.units import NS_PER_S

Times = NDArray[np.int64]

_SLEW_RATIO = 10_000
"""ns of the stream per 1 ns of correction: 100 ppm, the tolerance of a crystal."""
OVERLAP_SLEW_RATIO = 1000
"""The same for a correction that would repeat published times: 0.1 %, within the sigma of a wheel radius."""
_MAX_SLEW_NS = 2_000_000
_MAX_OVERLAP_NS = 60 * NS_PER_S  # beyond this the computer was suspended, and its clock stood still


class SlewedTimes:
    """Strictly increasing host times at the node's own rate; corrections up to 2 ms are slewed.

    A step between two samples would look like a change of the sample interval; but an error above 2 ms
    between two nodes would degrade their fusion: larger corrections are applied at once. The exception is one
    that would date samples before those published already: the first estimate was made from data read
    seconds late. It is slewed as well, or else the motion of seconds would be squeezed into one interval.
    """

    def __init__(self, clock: ClockSync) -> None:
        self._clock = clock
        self._clock_revision = self._clock_restarts = -1
        self._last: tuple[int, int] | None = None  # device and host time of the newest sample
        # Start (device time), size and rate of the correction being slewed.
        self._correction_start_ns = self._correction_ns = 0
        self._slew_ratio = _SLEW_RATIO

    @property
    def overlap_ns(self) -> int:
        """Return the size of the correction that would repeat published times, ns; 0 without one."""
        return self._correction_ns if self._slew_ratio == OVERLAP_SLEW_RATIO else 0

    def to_host_ns(self, device_ns: Times) -> Times:
        """Return strictly increasing host times (N,) ns of unwrapped device times (N,) ns."""
        if not len(device_ns):
            return device_ns
        if self._clock.revision != self._clock_revision:
            self._start_correction(int(device_ns[0]))
        steps = np.arange(len(device_ns))
        level = self._clock.to_host_ns(device_ns) - steps
        if self._correction_ns:
            slewed = np.maximum(device_ns - self._correction_start_ns, 0) // self._slew_ratio
            level += np.sign(self._correction_ns) * np.maximum(abs(self._correction_ns) - slewed, 0)
        if self._last is not None:
            level[0] = max(int(level[0]), self._last[1] + 1)
        host_ns: Times = np.maximum.accumulate(level) + steps
        self._last = int(device_ns[-1]), int(host_ns[-1])
        return host_ns

    def _start_correction(self, next_device_ns: int) -> None:
        is_same_boot = self._clock.restarts == self._clock_restarts
        self._clock_revision, self._clock_restarts = self._clock.revision, self._clock.restarts
        was_overlapping = self._slew_ratio == OVERLAP_SLEW_RATIO
        self._correction_ns, self._slew_ratio = 0, _SLEW_RATIO
        if self._last is None or not is_same_boot:
            return
        self._correction_start_ns, before = self._last
        estimates = np.array([self._correction_start_ns, next_device_ns], np.int64)
        corrected, following = self._clock.to_host_ns(estimates).tolist()
        correction_ns = before - corrected
        if abs(correction_ns) <= _MAX_SLEW_NS:
            self._correction_ns = correction_ns
        elif (following <= before or was_overlapping) and 0 < correction_ns <= _MAX_OVERLAP_NS:
            self._correction_ns, self._slew_ratio = correction_ns, OVERLAP_SLEW_RATIO
