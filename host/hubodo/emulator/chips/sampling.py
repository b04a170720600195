"""A chip's own sample clock: when sample k exists, what it holds, and the record of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.emulator.chips.faults import MissedSamples, OdrStep, ScriptedFault

Raw = NDArray[np.int16]
Measure = Callable[[Array], Raw]

BLOCK = 256
_FOREVER = float("inf")


def quantise(value: Array, lsb: float) -> Raw:
    """The output word nearest to `value` (same unit as `lsb`; halves to even), saturated to int16."""
    return np.clip(np.rint(value / lsb), -32768, 32767).astype(np.int16)


@dataclass(frozen=True)
class Truth:
    """What the chip made, sample by sample, in the order made.

    Attributes:
        t: (n,) s, true time of each sample since the board was switched on.
        raw: (n, c) int16, the output words: gyro x y z, accel x y z of an IMU; x y z of a magnetometer.
        temperature_raw: (n,) int16, the temperature word at that sample.
        lsb: (n, c) in SI per LSB, as in force at that sample.
        missed_t: (m,) s, when samples were due that a fault kept from being made.
        fifo_dropped: words that the FIFO overwrote before they were read.
    """

    t: Array
    raw: Raw
    temperature_raw: Raw
    lsb: Array
    missed_t: Array
    fifo_dropped: int = 0


class ChipClock:
    """Sample k after `start` exists at t_on + (k + 1) * period; the period is the specimen's own.

    Args:
        columns: words in one sample.
        odr_error: the specimen's rate is nominal * (1 + odr_error).
        odr_per_degree: relative change of rate per degC away from 25.
        temperature: degC of the chip at (n,) s.
        temperature_word: (n,) degC to the raw temperature word.
        faults: those of this chip; OdrStep and MissedSamples are heeded.
    """

    def __init__(
        self,
        columns: int,
        *,
        odr_error: float,
        odr_per_degree: float,
        temperature: Callable[[Array], Array],
        temperature_word: Callable[[Array], Raw],
        faults: tuple[ScriptedFault, ...] = (),
    ) -> None:
        self.columns = columns
        self._odr_error = odr_error
        self._odr_per_degree = odr_per_degree
        self._temperature = temperature
        self._temperature_word = temperature_word
        self._steps = sorted((f for f in faults if isinstance(f, OdrStep)), key=lambda f: f.t)
        self._misses = sorted((f for f in faults if isinstance(f, MissedSamples)), key=lambda f: f.t)
        self._to_miss = 0
        self._measure: Measure | None = None
        self._made: list[tuple[Array, Raw, Raw, Array]] = []
        self._missed: list[float] = []
        self._clear()

    def _clear(self) -> None:
        self._times: list[float] = []
        self._next = 0
        self._raw = np.zeros((0, self.columns), dtype=np.int16)
        self._bytes = b""
        self._temperature_words = np.zeros(0, dtype=np.int16)
        self._kept: list[int] = []
        self._time_next = _FOREVER

    @property
    def running(self) -> bool:
        """Whether samples are being made."""
        return self._measure is not None

    def start(self, t_on: float, nominal_hz: float, measure: Measure, lsb: Array) -> None:
        """Begin anew at t_on: `measure` turns (n,) s into (n, columns) words of `lsb` each."""
        self.stop()
        self._measure = measure
        self._nominal_hz = nominal_hz
        self._lsb = lsb
        self._anchor, self._anchor_count, self._period = t_on, 0, 0.0
        self._fill()

    def stop(self) -> None:
        """Make no more samples; what was made stays in the truth."""
        self._book()
        self._measure = None
        self._clear()

    def _rate(self, t: float) -> float:
        ratio = 1.0
        for step in self._steps:
            if step.t <= t:
                ratio *= step.ratio
        warmer = float(self._temperature(np.array([t]))[0]) - 25.0
        return self._nominal_hz * ratio * (1 + self._odr_error) * (1 + self._odr_per_degree * warmer)

    def _fill(self) -> None:
        assert self._measure is not None
        last = self._anchor + self._anchor_count * self._period
        period = 1.0 / self._rate(last)
        if period != self._period:
            self._anchor, self._anchor_count, self._period = last, 0, period
        count = np.arange(self._anchor_count + 1, self._anchor_count + 1 + BLOCK, dtype=np.float64)
        times: Array = self._anchor + period * count
        for step in self._steps:
            if last < step.t < times[-1]:
                times = times[: max(1, int(np.searchsorted(times, step.t, side="right")))]
                break
        self._anchor_count += len(times)
        self._raw = self._measure(times)
        self._bytes = self._raw.astype("<i2").tobytes()
        self._temperature_words = self._temperature_word(self._temperature(times))
        self._times = times.tolist()
        self._next = 0
        self._kept = []
        self._time_next = self._times[0]

    def _book(self) -> None:
        if self._kept:
            kept = np.array(self._kept)
            self._made.append(
                (
                    np.array(self._times)[kept],
                    self._raw[kept],
                    self._temperature_words[kept],
                    np.broadcast_to(self._lsb, (len(kept), self.columns)).astype(np.float64),
                )
            )
            self._kept = []

    @property
    def time_of_next(self) -> float:
        """True time at which the next sample is due, s; infinite when stopped."""
        return self._time_next

    def step(self, t: float) -> tuple[float, bytes, int] | None:
        """The next sample due at or before t as (time, little-endian words, temperature word), or None."""
        while self._time_next <= t:
            if self._next >= len(self._times):
                self._book()
                self._fill()
                continue
            i, when = self._next, self._time_next
            self._next = i + 1
            if self._next < len(self._times):
                self._time_next = self._times[self._next]
            else:
                self._time_next = self._anchor + (self._anchor_count + 1) * self._period
            if self._missing(when):
                self._missed.append(when)
                continue
            return self._keep(i, when)
        return None

    def _missing(self, when: float) -> bool:
        while self._misses and self._misses[0].t <= when:
            self._to_miss += self._misses.pop(0).n
        if self._to_miss:
            self._to_miss -= 1
            return True
        return False

    def _keep(self, i: int, when: float) -> tuple[float, bytes, int]:
        self._kept.append(i)
        size = 2 * self.columns
        return when, self._bytes[i * size : (i + 1) * size], int(self._temperature_words[i])

    def truth(self, fifo_dropped: int = 0) -> Truth:
        """All samples made so far."""
        self._book()
        if not self._made:
            none = np.zeros(0)
            empty = np.zeros((0, self.columns))
            return Truth(none, empty.astype(np.int16), none.astype(np.int16), empty, np.array(self._missed))
        t, raw, warm, lsb = (np.concatenate(parts) for parts in zip(*self._made, strict=True))
        return Truth(t, raw, warm, lsb, np.array(self._missed), fifo_dropped)
