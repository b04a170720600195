"""Overlapping Allan deviation of rate samples, with or without missing samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError

IntArray = NDArray[np.int64]

# Pairs per block: small enough that the phase samples of all averaging times stay in the processor's cache.
_BLOCK_PAIRS = 1 << 15
# A BLAS distributes longer dot products over threads, which is slower on a busy machine.
_MAX_DOT_SAMPLES = 1 << 13
_MIN_WINDOW_COVERAGE = 0.9


@dataclass(frozen=True)
class AllanPoints:
    """Allan deviation at P averaging times.

    Attributes:
        factors: (P,) averaging factors m.
        tau: (P,) averaging times m dt, s.
        adev: (P,) Allan deviation in the unit of the samples.
        pairs: (P,) number of overlapping window pairs behind each point.
        samples: length of the record on its even grid.
        dt: sample interval, s.
    """

    factors: IntArray
    tau: Array
    adev: Array
    pairs: IntArray
    samples: int
    dt: float


def averaging_factors(samples: int, per_octave: int = 1) -> IntArray:
    """Return the averaging factors 2^(k / per_octave), from 1 to the largest of which two windows fit."""
    if samples < 2:
        return np.zeros(0, np.int64)
    exponents = np.arange(0, per_octave * np.log2(samples / 2) + 1e-9)
    return np.unique(np.rint(2.0 ** (exponents / per_octave)).astype(np.int64))


def allan_deviation(
    samples: Array,
    dt: float,
    factors: Sequence[int] | IntArray | None = None,
    present: NDArray[np.bool_] | None = None,
) -> AllanPoints:
    """Return the overlapping Allan deviation (NIST SP 1065 eq. 11) of evenly spaced rates.

    samples: (N,) rates at intervals of dt (s). factors: averaging factors, octaves if None; factors of
    which two windows do not fit are omitted. present: (N,) False where a sample is missing; its value is
    not read. With missing samples, a window mean is taken over the samples present, and a pair counts if
    both windows hold at least 90 % of their samples. That raises the deviation of white noise by at most
    1/sqrt(0.9), 5.4 %, and by about p/2 in a record with a missing fraction p. Memory beyond the input:
    one array of N doubles, two if samples are missing. Raises InputError for fewer than two samples or a
    dt that is not a positive time.
    """
    count = len(samples)
    if count < 2:
        raise InputError(f"an Allan deviation needs at least 2 samples, there are {count}; record for longer")
    if not (dt > 0 and np.isfinite(dt)):
        raise InputError(f"sample interval {dt} s is not a positive time; check the time stamps")
    chosen = averaging_factors(count) if factors is None else np.asarray(factors, np.int64)
    chosen = chosen[(chosen >= 1) & (2 * chosen <= count)]
    if present is None or bool(present.all()):
        phase = _integrate(samples, None)
        sums, pairs = _sum_complete(phase, chosen), len(phase) - 2 * chosen
    else:
        phase = _integrate(samples, present)
        present_before = np.concatenate(([0], np.cumsum(present, dtype=np.int64)))
        results = [_sum_with_gaps(phase, present_before, int(m)) for m in chosen]
        sums = np.array([total for total, _ in results])
        pairs = np.array([number for _, number in results], np.int64)
    has_pairs = pairs > 0
    adev = np.sqrt(sums[has_pairs] / (2.0 * pairs[has_pairs]))
    tau = np.asarray(chosen[has_pairs] * dt, np.float64)
    return AllanPoints(chosen[has_pairs], tau, adev, pairs[has_pairs], count, dt)


def _integrate(samples: Array, present: NDArray[np.bool_] | None) -> Array:
    """Return the (N + 1,) running sum of the samples minus their mean, which limits rounding errors."""
    phase = np.empty(len(samples) + 1)
    phase[0] = 0.0
    if present is None:
        np.subtract(samples, samples.mean(), out=phase[1:])
    else:
        mean = float(np.mean(samples, where=present)) if present.any() else 0.0
        np.subtract(samples, mean, out=phase[1:])
        phase[1:][~present] = 0.0
    np.cumsum(phase[1:], out=phase[1:])
    return phase


def _sum_complete(phase: Array, factors: IntArray) -> Array:
    """Return the (P,) sums of squared differences of adjacent window means, for a complete record."""
    sums, work = np.zeros(len(factors)), np.empty(_BLOCK_PAIRS)
    for start in range(0, len(phase), _BLOCK_PAIRS):
        for row, m in enumerate(factors.tolist()):
            stop = min(start + _BLOCK_PAIRS, len(phase) - 2 * m)
            if stop <= start:
                continue
            middle = phase[start + m : stop + m]
            second = np.add(phase[start:stop], phase[start + 2 * m : stop + 2 * m], out=work[: stop - start])
            second -= middle
            second -= middle
            for at in range(0, len(second), _MAX_DOT_SAMPLES):
                part = second[at : at + _MAX_DOT_SAMPLES]
                sums[row] += part @ part
    return np.asarray(sums / factors.astype(np.float64) ** 2)


def _sum_with_gaps(phase: Array, present_before: IntArray, m: int) -> tuple[float, int]:
    """Return the sum of squared differences of adjacent window means at factor m, and the number of pairs.

    present_before: (N + 1,) number of samples present before each index.
    """
    min_present = max(1, int(np.ceil(_MIN_WINDOW_COVERAGE * m)))
    pairs, total = 0, 0.0
    for start in range(0, len(phase) - 2 * m, _BLOCK_PAIRS):
        stop = min(start + _BLOCK_PAIRS, len(phase) - 2 * m)
        first, middle, last = (slice(start + k * m, stop + k * m) for k in range(3))
        present_first, present_second = (
            present_before[middle] - present_before[first],
            present_before[last] - present_before[middle],
        )
        valid = (present_first >= min_present) & (present_second >= min_present)
        step = (phase[last] - phase[middle])[valid] / present_second[valid] - (phase[middle] - phase[first])[
            valid
        ] / present_first[valid]
        total += float(np.einsum("i,i->", step, step))
        pairs += len(step)
    return total, pairs
