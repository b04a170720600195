"""The band of frequencies in which a measured speed or yaw rate is motion of the vehicle, not vibration."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hubodo.arrays import Array
from hubodo.gap.problem.clock_alignment import align_times

# Spectra are means over at least this many half overlapping segments, and over bands of this ratio.
_MIN_SEGMENTS, _BAND_RATIO = 12, 2.0 ** (1.0 / 3.0)
_MAX_SEGMENT_DURATION, _MIN_SEGMENT_SAMPLES = 10.0, 64  # s, and samples
# Power relative to the noise alone at which motion and noise are equal; coherent share of the power of two
# sensors at which motion and noise are equal.
_EQUAL_POWER, _EQUAL_COHERENCE = 2.0, 0.5


def estimate_motion_band(t: Array, value: Array, second_sensor: tuple[Array, Array] | None = None) -> float:
    """Return the frequency, Hz, up to which samples show motion; infinite if there is no sign of vibration.

    Motion ends where a second sensor of the same motion is no longer coherent. Without a second sensor, the
    spectrum decides: that of motion falls, so a rise beyond a valley is vibration, and motion ends where the
    spectrum first comes down to the power of the deepest valley.

    t: (N,) s; value: (N,); second_sensor: times, (M,) s, and samples of another sensor of the same motion

    The clocks of both are aligned first: a delay is no vibration.
    """
    step = float(np.median(np.diff(t)))
    grid = np.arange(t[0], t[-1], step)
    segment = min(int(_MAX_SEGMENT_DURATION / step), 2 * len(grid) // _MIN_SEGMENTS)
    if segment < _MIN_SEGMENT_SAMPLES:
        return np.inf
    samples = np.interp(grid, t, value)
    others = samples
    if second_sensor is not None:
        other_t, other = second_sensor
        others = np.interp(grid, align_times(t, value, other_t, other, np.zeros_like(t)), other)

    def band_powers(a: Array, b: Array) -> Array:
        power = _cross_power(a, b, segment)
        return np.array([power[i:j].mean() for i, j in pairwise(edges)])

    edges = _band_edges(segment // 2 + 1)
    power = band_powers(samples, samples)
    if second_sensor is None:
        rise = np.maximum.accumulate(power[::-1])[::-1] / np.maximum(power, np.finfo(float).tiny)
        valley = int(np.argmax(rise))
        if rise[valley] < _EQUAL_POWER:
            return np.inf
        is_noise = power <= _EQUAL_POWER * power[valley]
    else:
        common = band_powers(samples, others)
        is_noise = common <= _EQUAL_COHERENCE * np.sqrt(power * band_powers(others, others))
        # The coherence of one band scatters by 0.1: a dip is not the end of the motion.
        is_noise[:-1] &= is_noise[1:]
        if not is_noise.any():
            return np.inf
    return edges[int(np.argmax(is_noise))] / (segment * step)


def _cross_power(a: Array, b: Array, segment: int) -> Array:
    """Return the real part of the one-sided cross spectrum, (segment // 2 + 1,), unit² times sample interval.

    Average over half overlapping segments, each without its mean and with a Hann window (Welch 1967).
    `scipy.signal` computes the same, but importing it takes a third of the start-up time of `hubodo gap`.
    """
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(segment) / segment)

    def spectra(samples: Array) -> Array:
        pieces = sliding_window_view(samples, segment)[:: segment - segment // 2]
        return np.asarray(np.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * window))

    of_a = spectra(a)
    of_b = of_a if b is a else spectra(b)
    power: Array = (of_a.real * of_b.real + of_a.imag * of_b.imag).mean(axis=0) / (window @ window)
    power[1 : (segment + 1) // 2] *= 2.0
    return power


def _band_edges(count: int) -> list[int]:
    """Return the first index of each band of `count` frequencies, excluding zero, and the end."""
    edges = [1]
    while edges[-1] < count:
        edges.append(max(edges[-1] + 1, int(np.ceil(edges[-1] * _BAND_RATIO))))
    return [*edges[:-1], count]
