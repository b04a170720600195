"""Sinusoidal terms of IEEE 952: coherent lines of a record, estimated and removed before the deviation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import median_filter
from scipy.optimize import minimize_scalar

from hubodo.arrays import Array
from hubodo.sensors.even_grid import EvenGrid

MAX_SINUSOIDS = 8
_FALSE_LINE_PROBABILITY = 1e-4
"""Probability that white noise has a line in one record."""
_MIN_CYCLES = 30
"""Slower lines are drift of the bias: they belong to B, K and R."""
_FLOOR_BINS = 101
"""Width of the running median that estimates the density of the noise around a line."""
_HANN_MEDIAN = float(np.log(2.0))


@dataclass(frozen=True)
class Sinusoid:
    """A line of a record.

    Attributes:
        frequency: Hz.
        amplitude, sigma: of the line, in the unit of the record.
    """

    frequency: float
    amplitude: float
    sigma: float

    def as_json(self) -> dict[str, Any]:
        """Return the line for the JSON result."""
        return {"frequency_hz": self.frequency, "amplitude": self.amplitude, "sigma": self.sigma}


def remove_sinusoids(record: EvenGrid) -> tuple[EvenGrid, tuple[Sinusoid, ...]]:
    """Return the record without its coherent lines, and the lines, strongest first.

    A line that does not keep its frequency, such as that of a motor that changes speed, remains in the
    record: a line is removed only if nothing of it is left at its frequency.
    """
    lines: list[Sinusoid] = []
    values = record.values
    while len(lines) < MAX_SINUSOIDS:
        frequency = _strongest_line(values, record, None)
        if frequency is None:
            break
        frequency, wave, line = _fit_line(values, record, frequency)
        remainder = np.where(record.present, values - wave, 0.0)
        if _strongest_line(remainder, record, frequency) is not None:
            break
        values = remainder
        lines.append(line)
    return replace(record, values=values) if lines else record, tuple(lines)


def _strongest_line(values: Array, record: EvenGrid, near: float | None) -> float | None:
    """Return the frequency, Hz, of the highest significant peak of the periodogram, or None.

    near: only peaks within three bins of this frequency count.
    """
    count = len(values)
    present = record.present
    centred = np.where(present, values - values[present].mean(), 0.0) * np.hanning(count)
    length = next_fast_len(count, real=True)
    power = np.abs(rfft(centred, length)) ** 2
    frequency = np.arange(len(power)) / (length * record.dt)
    first = int(np.ceil(_MIN_CYCLES * length / count))
    if len(power) - first < 2 * _FLOOR_BINS:
        return None
    ratio = power[first:] / (median_filter(power[first:], _FLOOR_BINS) / _HANN_MEDIAN + 1e-300)
    frequency = frequency[first:]
    if near is not None:
        ratio = np.where(np.abs(frequency - near) < 3.0 / (count * record.dt), ratio, 0.0)
    peak = int(np.argmax(ratio))
    threshold = np.log(len(ratio) / _FALSE_LINE_PROBABILITY)
    return float(frequency[peak]) if ratio[peak] > threshold else None


def _fit_line(values: Array, record: EvenGrid, frequency: float) -> tuple[float, Array, Sinusoid]:
    """Return frequency, wave (N,) and parameters of the line near a frequency, Hz."""
    t = np.arange(len(values)) * record.dt
    window = np.where(record.present, np.hanning(len(values)), 0.0)
    centred = window * (values - values[record.present].mean())

    def negative_power(trial: float) -> float:
        return -float(np.abs(centred @ np.exp(-2j * np.pi * trial * t)) ** 2)

    bin_width = 1.0 / (len(values) * record.dt)
    bounds = (frequency - bin_width, frequency + bin_width)
    best = float(minimize_scalar(negative_power, bounds=bounds, method="bounded").x)
    rotation = np.exp(2j * np.pi * best * t)
    amplitude = 2.0 * np.sum(centred * rotation.conj()) / window.sum()
    wave = np.real(amplitude * rotation)
    neighbours = [
        2.0 * abs(np.sum(centred * np.exp(-2j * np.pi * (best + k * bin_width) * t))) / window.sum()
        for k in (-6, -5, -4, 4, 5, 6)
    ]
    sigma = float(np.sqrt(np.mean(np.square(neighbours)) / 2.0))
    return best, wave, Sinusoid(best, float(abs(amplitude)), sigma)
