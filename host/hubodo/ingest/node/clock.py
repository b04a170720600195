"""Device time: wrap-around undone, and mapped to host time by offset and drift with an uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PERIOD_US = 1 << 30
_CLOCK_JUMP_US = 3_000_000
_OUT_OF_ORDER_US = 60_000_000  # a frame that waited for its link is younger than that

_DRIFT_PRIOR = 100e-6  # 1 sigma: a crystal with temperature; RC oscillators are pulled in by a reset
_DRIFT_WALK = 1e-7  # 1 sigma of the drift's random walk, 1/sqrt(s): a crystal that warms up
_OFFSET_WALK_NS = 2e3  # ns/sqrt(s): the node reads its clock in whole microseconds
_STAMP_NOISE_NS = 30e3  # scheduling of host and node besides the delays that are measured
_ONE_WAY_DELAY_NS = 20e6  # least delay of a frame is unknown; FTDI adapters alone wait 16 ms
_ONE_WAY_NOISE_NS = 1e6
_ONE_WAY_WINDOW_NS = 1_000_000_000
_SIGNIFICANT = 2.0
_MISSES_TO_RESET = 4


class TickUnwrapper:
    """Node ticks modulo 2^30 us to microseconds that go on counting.

    Ticks leave open how many whole periods of 1073.7 s have passed in silence. The host's time since the
    newest tick decides, where both clocks agree. They do not agree when the host was suspended or its clock
    was stepped; then node time goes forward by less than one period beyond what the node's counters show.
    """

    def __init__(self) -> None:
        self._last: int | None = None
        self._last_host_ns = 0

    def unwrap(self, t_us: int, host_ns: int, counted_us: int | None = None) -> int:
        """Return the ticks `t_us`, received at `host_ns`, on the unbroken scale; the first as they are.

        counted_us: unbroken ticks that the node's counters show to have been reached, where they show any.
        """
        if self._last is None:
            return self._accept(t_us, host_ns)
        if self.agrees(t_us, host_ns):
            return self._accept(self._expected(host_ns) + self.ahead(t_us, host_ns), host_ns)
        earliest = (self._last if counted_us is None else max(counted_us, self._last)) - _OUT_OF_ORDER_US
        return self._accept(earliest + (t_us - earliest) % PERIOD_US, host_ns)

    def ahead(self, t_us: int, host_ns: int) -> int:
        """How far ticks are ahead of an ideal clock's, us, within half a period; 0 before the first."""
        if self._last is None:
            return 0
        half = PERIOD_US // 2
        return (t_us - self._expected(host_ns) + half) % PERIOD_US - half

    def agrees(self, t_us: int, host_ns: int) -> bool:
        """Return True where the ticks are where the host's clock expects them: within 3 s and 0.1 %."""
        silence_us = abs(host_ns - self._last_host_ns) // 1000
        return abs(self.ahead(t_us, host_ns)) <= _CLOCK_JUMP_US + silence_us // 1000

    def _accept(self, value: int, host_ns: int) -> int:
        if self._last is None or value > self._last:
            self._last, self._last_host_ns = value, host_ns
        return value

    def _expected(self, host_ns: int) -> int:
        assert self._last is not None
        return self._last + (host_ns - self._last_host_ns) // 1000


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """Host time minus node time.

    offset_ns: at the newest measurement; drift: host seconds gained per node second, minus 1;
    sigma_ns: 1 sigma of a mapped time, systematic delay included; source: "none", "one way", "two way".
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
    """Kalman filter of [offset, drift] of one node's clock against the host's.

    A measurement is an exchange of four time stamps (Mills, RFC 5905: offset = half the sum of the two
    differences), whose error cannot exceed half the round trip. That bound does not average out where
    the delay is lopsided, so it is carried through the filter beside the variance: the estimate is a
    weighted mean of measurements, and its bound the same weighted mean of their bounds. A node that
    cannot answer is followed by the earliest arrivals, with the unknown least delay as the bound.
    """

    def __init__(self) -> None:
        self._resets = 0
        self.changes = 0
        """Grows whenever the estimate changes."""
        self._clear()

    def _clear(self) -> None:
        self.changes += 1
        self._source = "none"
        self._exchanges = 0
        self._base_ns = 0
        self._at_ns = 0  # device time of the state
        self._offset = 0.0  # ns, beside _base_ns
        self._drift = 0.0
        self._p00 = self._p01 = self._p11 = 0.0
        self._bound = 0.0
        self._misses = 0
        self._window: tuple[int, int] | None = None  # best (arrival minus device, device) of this second
        self._window_end = 0

    def reset(self) -> None:
        """Forget everything: the node's clock has started anew."""
        self._clear()
        self._resets += 1

    @property
    def source(self) -> str:
        """What the estimate rests on: "none", "one way" or "two way"."""
        return self._source

    @property
    def exchanges(self) -> int:
        """How many answers it rests on."""
        return self._exchanges

    @property
    def resets(self) -> int:
        """How often it was begun anew."""
        return self._resets

    def exchange(self, sent_ns: int, received_us: int, replied_us: int, arrived_ns: int) -> bool:
        """One request and its answer: host sends, node receives, node replies, host receives.

        Returns False when the four stamps contradict each other or the estimate so far.
        """
        trip = (arrived_ns - sent_ns) - (replied_us - received_us) * 1000
        if trip < 0 or replied_us < received_us:
            return False
        device_ns = (received_us + replied_us) * 500
        measured = (sent_ns + arrived_ns) // 2 - device_ns
        # Where within the round trip the node read its clock is not known: a uniform law.
        variance = _STAMP_NOISE_NS**2 + trip**2 / 12
        if self._source != "two way":
            self._start(measured, device_ns, variance, 0.5 * trip, "two way")
            return True
        if self._update(measured, device_ns, variance, 0.5 * trip):
            self._exchanges += 1
            return True
        return False

    def arrival(self, device_us: int, arrived_ns: int) -> None:
        """A frame made at `device_us` has arrived; of use only while the node answers no request."""
        if self._source == "two way":
            return
        device_ns = device_us * 1000
        late = arrived_ns - device_ns
        if self._window is None:
            self._window = (late, device_ns)
            self._window_end = arrived_ns + _ONE_WAY_WINDOW_NS
            if self._source == "none":
                self._start(late, device_ns, _ONE_WAY_DELAY_NS**2, _ONE_WAY_DELAY_NS, "one way")
        elif late < self._window[0]:
            self._window = (late, device_ns)
        if arrived_ns >= self._window_end:
            self._update(*self._window, _ONE_WAY_NOISE_NS**2, _ONE_WAY_DELAY_NS)
            self._window = None

    def host_ns(self, device_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Device times (N,) ns on the unbroken scale to host times (N,) ns."""
        since = device_ns - self._at_ns
        drift = self._drift if self._significant() else 0.0
        shift = np.rint(self._offset + drift * since).astype(np.int64)
        mapped: NDArray[np.int64] = device_ns + self._base_ns + shift
        return mapped

    def sigma_ns(self, device_ns: int) -> float:
        """1 sigma of a mapped time, ns: variance of the filter and, as of a uniform law, the delay bound."""
        dt = (device_ns - self._at_ns) * 1e-9
        p00 = (
            self._p00 + 2 * dt * self._p01 + dt * dt * self._p11 + (_DRIFT_WALK * 1e9) ** 2 * abs(dt) ** 3 / 3
        )
        unused = 0.0 if self._significant() else self._drift * dt * 1e9
        return math.sqrt(max(p00, 0.0) + self._bound**2 / 3) + abs(unused)

    def estimate(self) -> ClockEstimate:
        return ClockEstimate(
            offset_ns=self._base_ns + round(self._offset),
            drift=self._drift,
            drift_sigma=math.sqrt(self._p11) * 1e-9,
            drift_used=self._significant(),
            sigma_ns=self.sigma_ns(self._at_ns),
            source=self._source,
            exchanges=self._exchanges,
            resets=self._resets,
        )

    def _significant(self) -> bool:
        return self._drift**2 * 1e18 > _SIGNIFICANT**2 * self._p11

    def _start(self, measured: int, device_ns: int, variance: float, bound: float, source: str) -> None:
        self.changes += 1
        self._source = source
        self._exchanges = 1 if source == "two way" else 0
        self._base_ns, self._at_ns, self._offset = measured, device_ns, 0.0
        self._drift, self._bound, self._misses = 0.0, bound, 0
        self._p00, self._p01, self._p11 = variance, 0.0, (_DRIFT_PRIOR * 1e9) ** 2

    def _update(self, measured: int, device_ns: int, variance: float, bound: float) -> bool:
        """One Kalman step; False when the measurement cannot belong to this clock."""
        dt = (device_ns - self._at_ns) * 1e-9
        if dt < 0:
            return False
        walk = (_DRIFT_WALK * 1e9) ** 2
        offset = self._offset + self._drift * dt * 1e9
        p00 = (
            self._p00 + 2 * dt * self._p01 + dt * dt * self._p11 + walk * dt**3 / 3 + _OFFSET_WALK_NS**2 * dt
        )
        p01 = self._p01 + dt * self._p11 + walk * dt * dt / 2
        p11 = self._p11 + walk * dt
        innovation = (measured - self._base_ns) - offset
        if abs(innovation) > self._bound + bound + 5 * math.sqrt(p00 + variance):
            self._misses += 1
            if self._misses >= _MISSES_TO_RESET:
                source = self._source
                self._resets += 1
                self._start(measured, device_ns, variance, bound, source)
            return False
        self._misses = 0
        self.changes += 1
        s = p00 + variance
        k0, k1 = p00 / s, p01 / s
        self._at_ns = device_ns
        self._offset = offset + k0 * innovation
        self._drift += k1 * innovation * 1e-9
        self._p00, self._p01, self._p11 = (1 - k0) * p00, (1 - k0) * p01, p11 - k1 * p01
        self._bound = (1 - k0) * self._bound + k0 * bound
        return True
