"""Unwrapping of device ticks, and a Kalman filter that maps device time to host time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TICK_PERIOD_US = 1 << 30
_MAX_CLOCK_JUMP_US = 3_000_000  # beyond this, the node has restarted or a clock was stepped
_MAX_REORDER_US = 60_000_000  # a frame that waited for its link is younger than this

_DRIFT_PRIOR_SIGMA = (
    100e-6  # 1 sigma: a crystal over temperature; RC oscillators are handled by a filter reset
)
_DRIFT_WALK_PER_SQRT_S = 1e-7  # 1 sigma of the drift's random walk, 1/sqrt(s): a crystal during warm-up
_OFFSET_WALK_NS_PER_SQRT_S = 2e3  # the node reads its clock in whole microseconds
_STAMP_NOISE_NS = 30e3  # 1 sigma: scheduling of host and node in addition to the measured delays
_ONE_WAY_DELAY_NS = 20e6  # bound: the minimum delay of a frame is unknown; FTDI adapters alone wait 16 ms
_ONE_WAY_NOISE_NS = 1e6  # 1 sigma of the earliest arrival in a window
_ONE_WAY_WINDOW_NS = 1_000_000_000
_DRIFT_SIGNIFICANCE_SIGMA = 2.0
_REJECTIONS_TO_RESET = 4
_LATE_WINDOWS_TO_RESET = 60
"""Consecutive windows of late arrivals before a reset. A frame can be read late, never before it was sent:
late arrivals for seconds show a starved computer, for a minute a node whose clock stood still."""


class TickUnwrapper:
    """An unwrapper of node ticks modulo 2^30 us to monotonic microseconds.

    Ticks leave open how many whole periods of 1073.7 s have passed during silence. The host time elapsed
    since the newest tick decides, if both clocks agree. They disagree if the host was suspended or its clock
    was stepped: then node time advances by less than one period beyond the time shown by the node's counters.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._last_host_ns = 0

    def unwrap(self, t_us: int, host_ns: int, earliest_us: int | None = None) -> int:
        """Return the unwrapped ticks of `t_us`, received at `host_ns`; the first remain unchanged.

        earliest_us: lower bound of the unwrapped ticks from the node's counters; None where unknown.
        """
        if self._last_us is None:
            return self._accept(t_us, host_ns)
        if self.agrees_with_host(t_us, host_ns):
            return self._accept(self._expected_us(host_ns) + self.ticks_ahead(t_us, host_ns), host_ns)
        earliest = (
            self._last_us if earliest_us is None else max(earliest_us, self._last_us)
        ) - _MAX_REORDER_US
        return self._accept(earliest + (t_us - earliest) % TICK_PERIOD_US, host_ns)

    def ticks_ahead(self, t_us: int, host_ns: int) -> int:
        """Return how far ticks are ahead of an ideal clock, us, within half a period; 0 before the first."""
        if self._last_us is None:
            return 0
        half = TICK_PERIOD_US // 2
        return (t_us - self._expected_us(host_ns) + half) % TICK_PERIOD_US - half

    def agrees_with_host(self, t_us: int, host_ns: int) -> bool:
        """Return True if the ticks agree with the host clock within 3 s plus 0.1 % of the silence."""
        silence_us = abs(host_ns - self._last_host_ns) // 1000
        return abs(self.ticks_ahead(t_us, host_ns)) <= _MAX_CLOCK_JUMP_US + silence_us // 1000

    def _accept(self, ticks_us: int, host_ns: int) -> int:
        if self._last_us is None or ticks_us > self._last_us:
            self._last_us, self._last_host_ns = ticks_us, host_ns
        return ticks_us

    def _expected_us(self, host_ns: int) -> int:
        assert self._last_us is not None
        return self._last_us + (host_ns - self._last_host_ns) // 1000


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """Estimate of host time minus node time.

    Attributes
    ----------
    offset_ns
        Offset at the newest measurement.
    drift, drift_sigma
        Host seconds per node second minus 1, and its standard deviation.
    drift_used
        True where the drift is significant and therefore applied.
    sigma_ns
        Standard deviation of a mapped time, systematic delay included.
    source
        "none", "one way" (arrival times) or "two way" (request and reply).
    exchanges, resets
        Numbers of accepted exchanges and of filter resets.
    """

    offset_ns: int
    drift: float
    drift_sigma: float
    drift_used: bool
    sigma_ns: float
    source: str
    exchanges: int
    resets: int

    def as_json(self) -> dict[str, object]:
        """Return the estimate in s and ppm."""
        return {
            "offset": self.offset_ns * 1e-9,
            "drift_ppm": self.drift * 1e6,
            "drift_sigma_ppm": self.drift_sigma * 1e6,
            "drift_used": self.drift_used,
            "sigma": self.sigma_ns * 1e-9,
            "source": self.source,
            "exchanges": self.exchanges,
            "resets": self.resets,
        }


class ClockSync:
    """A Kalman filter of [offset, drift] of one node's clock relative to the host's.

    A measurement is an exchange of four time stamps (Mills, RFC 5905: offset = half the sum of the two
    differences), whose error cannot exceed half the round trip. This bound does not average out where the
    delay is asymmetric, so it is propagated beside the variance: the estimate is a weighted mean of
    measurements, and its bound the same weighted mean of their bounds. The clock of a node that does not
    answer requests is estimated from the earliest arrivals, with the unknown minimum delay as the bound.
    """

    def __init__(self) -> None:
        self._resets = 0
        self.restarts = 0
        """Number of restarts of the node's clock."""
        self.revision = 0
        """Counter that increases whenever the estimate changes."""
        self._reset_state()

    def _reset_state(self) -> None:
        self.revision += 1
        self._source = "none"
        self._exchanges = 0
        self._base_ns = 0
        self._state_device_ns = 0  # device time at which the state is valid
        self._offset = 0.0  # ns, relative to _base_ns
        self._drift = 0.0
        self._p00 = self._p01 = self._p11 = 0.0
        self._bound = 0.0
        self._rejections = 0
        self._window: tuple[int, int] | None = (
            None  # smallest (arrival minus device time, device time) of this second
        )
        self._window_end = 0

    def reset(self) -> None:
        """Reset the estimate after a restart of the node's clock."""
        self._reset_state()
        self._resets += 1
        self.restarts += 1

    @property
    def source(self) -> str:
        """Measurements behind the estimate: "none", "one way" or "two way"."""
        return self._source

    @property
    def exchanges(self) -> int:
        """Number of exchanges behind the estimate."""
        return self._exchanges

    @property
    def resets(self) -> int:
        """Number of resets of the estimate."""
        return self._resets

    def add_exchange(self, sent_ns: int, received_us: int, replied_us: int, arrived_ns: int) -> bool:
        """Update with one exchange: host sends, node receives, node replies, host receives.

        Return False if the four stamps contradict each other or are rejected by the innovation gate.
        """
        round_trip_ns = (arrived_ns - sent_ns) - (replied_us - received_us) * 1000
        if round_trip_ns < 0 or replied_us < received_us:
            return False
        device_ns = (received_us + replied_us) * 500
        measured_offset_ns = (sent_ns + arrived_ns) // 2 - device_ns
        # The node read its clock at an unknown time within the round trip: uniform distribution.
        variance = _STAMP_NOISE_NS**2 + round_trip_ns**2 / 12
        if self._source != "two way":
            self._initialise(measured_offset_ns, device_ns, variance, 0.5 * round_trip_ns, "two way")
            return True
        if self._update(measured_offset_ns, device_ns, variance, 0.5 * round_trip_ns):
            self._exchanges += 1
            return True
        return False

    def add_arrival(self, device_us: int, arrived_ns: int) -> None:
        """Update with the arrival of a frame sent at `device_us`; ignored once the node answers requests."""
        if self._source == "two way":
            return
        device_ns = device_us * 1000
        difference_ns = arrived_ns - device_ns
        if self._window is None:
            self._window = (difference_ns, device_ns)
            self._window_end = arrived_ns + _ONE_WAY_WINDOW_NS
            if self._source == "none":
                self._initialise(difference_ns, device_ns, _ONE_WAY_DELAY_NS**2, _ONE_WAY_DELAY_NS, "one way")
        elif difference_ns < self._window[0]:
            self._window = (difference_ns, device_ns)
        if arrived_ns >= self._window_end:
            self._update(*self._window, _ONE_WAY_NOISE_NS**2, _ONE_WAY_DELAY_NS)
            self._window = None

    def to_host_ns(self, device_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return host times (N,) ns of unwrapped device times (N,) ns."""
        since = device_ns - self._state_device_ns
        drift = self._drift if self._drift_is_significant() else 0.0
        shift = np.rint(self._offset + drift * since).astype(np.int64)
        mapped: NDArray[np.int64] = device_ns + self._base_ns + shift
        return mapped

    def sigma_ns(self, device_ns: int) -> float:
        """Return 1 sigma of a mapped time, ns: filter variance plus that of the uniform delay bound."""
        dt = (device_ns - self._state_device_ns) * 1e-9
        p00 = (
            self._p00
            + 2 * dt * self._p01
            + dt * dt * self._p11
            + (_DRIFT_WALK_PER_SQRT_S * 1e9) ** 2 * abs(dt) ** 3 / 3
        )
        unused = 0.0 if self._drift_is_significant() else self._drift * dt * 1e9
        return math.sqrt(max(p00, 0.0) + self._bound**2 / 3) + abs(unused)

    def estimate(self) -> ClockEstimate:
        """Return the present estimate."""
        return ClockEstimate(
            offset_ns=self._base_ns + round(self._offset),
            drift=self._drift,
            drift_sigma=math.sqrt(self._p11) * 1e-9,
            drift_used=self._drift_is_significant(),
            sigma_ns=self.sigma_ns(self._state_device_ns),
            source=self._source,
            exchanges=self._exchanges,
            resets=self._resets,
        )

    def _drift_is_significant(self) -> bool:
        return self._drift**2 * 1e18 > _DRIFT_SIGNIFICANCE_SIGMA**2 * self._p11

    def _initialise(
        self, measured_offset_ns: int, device_ns: int, variance: float, bound: float, source: str
    ) -> None:
        self.revision += 1
        self._source = source
        self._exchanges = 1 if source == "two way" else 0
        self._base_ns, self._state_device_ns, self._offset = measured_offset_ns, device_ns, 0.0
        self._drift, self._bound, self._rejections = 0.0, bound, 0
        self._p00, self._p01, self._p11 = variance, 0.0, (_DRIFT_PRIOR_SIGMA * 1e9) ** 2

    def _update(self, measured_offset_ns: int, device_ns: int, variance: float, bound: float) -> bool:
        """Apply one Kalman step; return False if the innovation gate rejects the measurement."""
        dt = (device_ns - self._state_device_ns) * 1e-9
        if dt < 0:
            return False
        walk = (_DRIFT_WALK_PER_SQRT_S * 1e9) ** 2
        offset = self._offset + self._drift * dt * 1e9
        p00 = (
            self._p00
            + 2 * dt * self._p01
            + dt * dt * self._p11
            + walk * dt**3 / 3
            + _OFFSET_WALK_NS_PER_SQRT_S**2 * dt
        )
        p01 = self._p01 + dt * self._p11 + walk * dt * dt / 2
        p11 = self._p11 + walk * dt
        innovation = (measured_offset_ns - self._base_ns) - offset
        if abs(innovation) > self._bound + bound + 5 * math.sqrt(p00 + variance):
            self._rejections += 1
            source = self._source
            is_late_arrival = source == "one way" and innovation > 0.0
            if self._rejections >= (_LATE_WINDOWS_TO_RESET if is_late_arrival else _REJECTIONS_TO_RESET):
                self._resets += 1
                self._initialise(measured_offset_ns, device_ns, variance, bound, source)
            return False
        self._rejections = 0
        self.revision += 1
        s = p00 + variance
        k0, k1 = p00 / s, p01 / s
        self._state_device_ns = device_ns
        self._offset = offset + k0 * innovation
        self._drift += k1 * innovation * 1e-9
        self._p00, self._p01, self._p11 = (1 - k0) * p00, (1 - k0) * p01, p11 - k1 * p01
        self._bound = (1 - k0) * self._bound + k0 * bound
        return True
