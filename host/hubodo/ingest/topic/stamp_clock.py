"""Host times of the header stamps of one topic."""

from __future__ import annotations

import numpy as np

from hubodo.ingest.node.clock import ClockSync
from hubodo.ingest.node.slewed_times import SlewedTimes
from hubodo.units import NS_PER_S

_MAX_OWN_CLOCK_DELAY_NS = 2 * NS_PER_S
"""Up to this delay of the first message, its stamp is assumed to come from the clock of this computer."""
_MAX_EARLY_NS, _MAX_LATE_NS = NS_PER_S // 2, 30 * NS_PER_S
"""Bounds of the delay of a message relative to the others; beyond them its stamp is invalid. On an overloaded
computer messages wait for seconds."""
_MIN_STEP_MESSAGES = 20
"""Consecutive invalid stamps with the same delay after which the publisher's clock is assumed to be set."""


class StampClock:
    """Converts stamps to host time.

    Stamps of nodes on this computer are times of its wall clock and are converted exactly. If the first stamp
    differs from that clock by more than 2 s, the publisher has another clock (another computer, or the time
    of a simulator), which is then estimated from the times of arrival.
    """

    def __init__(self) -> None:
        self.steps = 0
        """Number of times that the publisher's clock was set."""
        self._delay_ns: int | None = None
        self._sync: ClockSync | None = None
        self._times = SlewedTimes(ClockSync())
        self._suspect_delay_ns = self._suspects = 0

    @property
    def sync(self) -> ClockSync:
        """Estimate of the publisher's clock, without measurements if it is that of this computer."""
        return self._sync or ClockSync()

    def to_host_ns(self, stamp_ns: int, received_ns: int, wall_offset_ns: int) -> int | None:
        """Return the host time of a stamp; None if the stamp is invalid.

        A stamp of 0 was not set; the time of arrival replaces it. wall_offset_ns: host minus wall clock.
        """
        if stamp_ns == 0:
            return received_ns
        delay_ns = received_ns - wall_offset_ns - stamp_ns
        if self._delay_ns is None:
            self._anchor(delay_ns)
        assert self._delay_ns is not None
        late_ns = delay_ns - self._delay_ns
        if not -_MAX_EARLY_NS < late_ns < _MAX_LATE_NS:
            if not self._is_step(delay_ns):
                return None
            late_ns = 0
        self._suspects = 0
        if self._sync is None:
            return stamp_ns + wall_offset_ns
        # The reference is the smallest delay, and follows the drift of the other clock.
        self._delay_ns += late_ns if late_ns < 0 else late_ns // 1000
        self._sync.add_arrival(stamp_ns // 1000, received_ns)
        return int(self._times.to_host_ns(np.array([stamp_ns], np.int64))[0])

    def _is_step(self, delay_ns: int) -> bool:
        """Count an invalid stamp; once enough agree that the clock was set, restart and return True."""
        if self._suspects and abs(delay_ns - self._suspect_delay_ns) < NS_PER_S:
            self._suspects += 1
        else:
            self._suspects = 1
        self._suspect_delay_ns = delay_ns
        if self._suspects < _MIN_STEP_MESSAGES:
            return False
        self.steps += 1
        self._anchor(delay_ns)
        return True

    def _anchor(self, delay_ns: int) -> None:
        is_own = abs(delay_ns) <= _MAX_OWN_CLOCK_DELAY_NS
        self._delay_ns = 0 if is_own else delay_ns
        self._sync = None if is_own else ClockSync()
        if self._sync is not None:
            self._times = SlewedTimes(self._sync)
