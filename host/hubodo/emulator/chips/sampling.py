"""Sample clock of an emulated chip, with a record of every sample and its true time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.emulator.chips.faults import MissedSamples, OdrStep, ScriptedFault

RawWords = NDArray[np.int16]
MeasureFunction = Callable[[Array], RawWords]

SAMPLES_PER_BLOCK = 256
_NEVER = float("inf")


def quantise(value: Array, lsb: float) -> RawWords:
    """Return the output words nearest to `value`, saturated to int16; `lsb` is in the unit of `value`.

    Halves are rounded to even.
    """
    return np.clip(np.rint(value / lsb), -32768, 32767).astype(np.int16)


@dataclass(frozen=True)
class ChipSamples:
    """All samples of a chip, in the order in which they were measured.

    Attributes
    ----------
    t : (n,) s since power-on of the board, true time of each sample.
    raw : (n, c) output words: gyro x y z, accel x y z of an IMU; x y z of a magnetometer.
    temperature_raw : (n,) temperature word at each sample.
    lsb : (n, c) SI unit per LSB, at the range of each sample.
    missed_t : (m,) s, true times of samples that a fault suppressed.
    fifo_dropped : number of words that the FIFO overwrote before they were read.
    """

    t: Array
    raw: RawWords
    temperature_raw: RawWords
    lsb: Array
    missed_t: Array
    fifo_dropped: int = 0


class SampleClock:
    """Sample clock of one chip: sample k after `start` is measured at t_on + (k + 1) period.

    The period includes the rate error of the specimen.

    Parameters
    ----------
    columns : words per sample.
    odr_error : relative error of the output data rate.
    odr_per_degree : relative change of the rate per °C from 25 °C.
    temperature : function of t, (n,) s, that returns the temperature of the chip in °C.
    temperature_word : function from °C to the raw temperature word.
    faults : faults of this chip; `OdrStep` and `MissedSamples` apply here.
    """

    def __init__(
        self,
        columns: int,
        *,
        odr_error: float,
        odr_per_degree: float,
        temperature: Callable[[Array], Array],
        temperature_word: Callable[[Array], RawWords],
        faults: tuple[ScriptedFault, ...] = (),
    ) -> None:
        self.columns = columns
        self._odr_error = odr_error
        self._odr_per_degree = odr_per_degree
        self._temperature = temperature
        self._temperature_word = temperature_word
        self._rate_steps = sorted((f for f in faults if isinstance(f, OdrStep)), key=lambda f: f.t)
        self._missed_faults = sorted((f for f in faults if isinstance(f, MissedSamples)), key=lambda f: f.t)
        self._pending_misses = 0
        self._measure: MeasureFunction | None = None
        self._recorded_blocks: list[tuple[Array, RawWords, RawWords, Array]] = []
        self._missed: list[float] = []
        self._clear()

    def _clear(self) -> None:
        """Discard the current block of samples."""
        self._times: list[float] = []
        self._next_index = 0
        self._raw = np.zeros((0, self.columns), dtype=np.int16)
        self._raw_bytes = b""
        self._temperature_words = np.zeros(0, dtype=np.int16)
        self._recorded_indices: list[int] = []
        self._next_time = _NEVER

    def start(self, t_on: float, nominal_hz: float, measure: MeasureFunction, lsb: Array) -> None:
        """Restart sampling at t_on; `measure` returns (n, columns) words of `lsb` for (n,) s."""
        self.stop()
        self._measure = measure
        self._nominal_hz = nominal_hz
        self._lsb = lsb
        self._anchor_time, self._anchor_count, self._period = t_on, 0, 0.0
        self._measure_block()

    def stop(self) -> None:
        """Stop sampling; past samples stay in the record."""
        self._record_block()
        self._measure = None
        self._clear()

    def _rate(self, t: float) -> float:
        """Return the true sample rate at t, Hz."""
        ratio = 1.0
        for rate_step in self._rate_steps:
            if rate_step.t <= t:
                ratio *= rate_step.ratio
        above_reference = float(self._temperature(np.array([t]))[0]) - 25.0
        return self._nominal_hz * ratio * (1 + self._odr_error) * (1 + self._odr_per_degree * above_reference)

    def _measure_block(self) -> None:
        """Measure the next block of samples."""
        assert self._measure is not None
        last = self._anchor_time + self._anchor_count * self._period
        period = 1.0 / self._rate(last)
        if period != self._period:
            self._anchor_time, self._anchor_count, self._period = last, 0, period
        ticks = np.arange(
            self._anchor_count + 1, self._anchor_count + 1 + SAMPLES_PER_BLOCK, dtype=np.float64
        )
        times: Array = self._anchor_time + period * ticks
        for rate_step in self._rate_steps:
            if last < rate_step.t < times[-1]:
                times = times[: max(1, int(np.searchsorted(times, rate_step.t, side="right")))]
                break
        self._anchor_count += len(times)
        self._raw = self._measure(times)
        self._raw_bytes = self._raw.astype("<i2").tobytes()
        self._temperature_words = self._temperature_word(self._temperature(times))
        self._times = times.tolist()
        self._next_index = 0
        self._recorded_indices = []
        self._next_time = self._times[0]

    def _record_block(self) -> None:
        """Move the samples of the current block to the record."""
        if self._recorded_indices:
            indices = np.array(self._recorded_indices)
            self._recorded_blocks.append(
                (
                    np.array(self._times)[indices],
                    self._raw[indices],
                    self._temperature_words[indices],
                    np.broadcast_to(self._lsb, (len(indices), self.columns)).astype(np.float64),
                )
            )
            self._recorded_indices = []

    @property
    def next_sample_time(self) -> float:
        """True time of the next sample, s; infinite when stopped."""
        return self._next_time

    def next_sample(self, t: float) -> tuple[float, bytes, int] | None:
        """Return time, little-endian words and temperature word of the next sample due by t, or None."""
        while self._next_time <= t:
            if self._next_index >= len(self._times):
                self._record_block()
                self._measure_block()
                continue
            index, when = self._next_index, self._next_time
            self._next_index = index + 1
            if self._next_index < len(self._times):
                self._next_time = self._times[self._next_index]
            else:
                self._next_time = self._anchor_time + (self._anchor_count + 1) * self._period
            if self._is_missed(when):
                self._missed.append(when)
                continue
            return self._record_sample(index, when)
        return None

    def samples_until(self, t: float) -> Iterator[tuple[float, bytes, int]]:
        """Yield the samples due by t, as `next_sample` does; the clock may be stopped meanwhile."""
        while (sample := self.next_sample(t)) is not None:
            yield sample

    def _is_missed(self, when: float) -> bool:
        """Return True if a fault suppresses the sample at `when`."""
        while self._missed_faults and self._missed_faults[0].t <= when:
            self._pending_misses += self._missed_faults.pop(0).n
        if self._pending_misses:
            self._pending_misses -= 1
            return True
        return False

    def _record_sample(self, index: int, when: float) -> tuple[float, bytes, int]:
        """Record sample i of the block and return it, as `next_sample`."""
        self._recorded_indices.append(index)
        size = 2 * self.columns
        return when, self._raw_bytes[index * size : (index + 1) * size], int(self._temperature_words[index])

    def truth(self, fifo_dropped: int = 0) -> ChipSamples:
        """Return all samples so far."""
        self._record_block()
        if not self._recorded_blocks:
            no_times, no_rows = np.zeros(0), np.zeros((0, self.columns))
            return ChipSamples(
                no_times, no_rows.astype(np.int16), no_times.astype(np.int16), no_rows, np.array(self._missed)
            )
        t, raw, temperature_raw, lsb = (
            np.concatenate(parts) for parts in zip(*self._recorded_blocks, strict=True)
        )
        return ChipSamples(t, raw, temperature_raw, lsb, np.array(self._missed), fifo_dropped)
