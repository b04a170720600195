"""Overlapping Allan deviation of rate samples, also where some are missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Pairs taken at a time: few enough for a cache, which then holds what several averaging times need.
_BLOCK = 1 << 15
# A longer dot product is spread over threads by a BLAS, and waits there for a busy core.
_DOT = 1 << 13
_MIN_COVERAGE = 0.9


@dataclass(frozen=True)
class AllanPoints:
    """Allan deviation at some averaging times.

    factors: (P,) averaging factors m; tau: (P,) m dt in s; adev: (P,) in the unit of the samples;
    pairs: (P,) number of overlapping pairs of windows behind each point; samples: length of the record on its
    even grid; dt: sample interval in s.
    """

    factors: IntArray
    tau: FloatArray
    adev: FloatArray
    pairs: IntArray
    samples: int
    dt: float


def averaging_factors(samples: int, per_octave: int = 1) -> IntArray:
    """(P,) increasing averaging factors 2^(k / per_octave), from 1 to the last of which two windows fit."""
    if samples < 2:
        return np.zeros(0, np.int64)
    exponents = np.arange(0, per_octave * np.log2(samples / 2) + 1e-9)
    return np.unique(np.rint(2.0 ** (exponents / per_octave)).astype(np.int64))


def allan_deviation(
    samples: FloatArray,
    dt: float,
    factors: Sequence[int] | IntArray | None = None,
    present: NDArray[np.bool_] | None = None,
) -> AllanPoints:
    """Overlapping Allan deviation, NIST SP 1065 eq. (11), of the mean rates in adjacent windows.

    samples: (N,) rates, evenly spaced by dt (s). factors: averaging factors, octaves where None; those of
    which two windows do not fit are left out. present: (N,) False where a sample is missing; its value is not
    read. A window then is the mean of what it holds, and a pair counts when both windows hold at least 90 %
    of their samples, which lifts the deviation of white noise by at most 1/sqrt(0.9), 5.4 %, and in a record
    with a missing fraction p by about p/2. Memory beyond the input: one array of N doubles, two when some are
    missing. Raises InputError for fewer than two samples or a dt that is no positive time.
    """
    count = len(samples)
    if count < 2:
        raise InputError(f"an Allan deviation needs at least 2 samples, there are {count}; record for longer")
    if not (dt > 0 and np.isfinite(dt)):
        raise InputError(f"sample interval {dt} s is no positive time; check the time stamps")
    chosen = averaging_factors(count) if factors is None else np.asarray(factors, np.int64)
    chosen = chosen[(chosen >= 1) & (2 * chosen <= count)]
    if present is None or bool(present.all()):
        phase = _integral(samples, None)
        sums, pairs = _complete(phase, chosen), len(phase) - 2 * chosen
    else:
        phase = _integral(samples, present)
        held = np.concatenate(([0], np.cumsum(present, dtype=np.int64)))
        found = [_with_gaps(phase, held, int(m)) for m in chosen]
        sums = np.array([total for total, _ in found])
        pairs = np.array([number for _, number in found], np.int64)
    kept = pairs > 0
    adev = np.sqrt(sums[kept] / (2.0 * pairs[kept]))
    tau = np.asarray(chosen[kept] * dt, np.float64)
    return AllanPoints(chosen[kept], tau, adev, pairs[kept], count, dt)


def _integral(samples: FloatArray, present: NDArray[np.bool_] | None) -> FloatArray:
    """(N + 1,) running sum from 0 of the samples less their mean, which keeps the sums small and exact."""
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


def _complete(phase: FloatArray, factors: IntArray) -> FloatArray:
    """(P,) sums of squared differences of adjacent window means; all averaging times block by block."""
    sums, work = np.zeros(len(factors)), np.empty(_BLOCK)
    for start in range(0, len(phase), _BLOCK):
        for row, m in enumerate(factors.tolist()):
            stop = min(start + _BLOCK, len(phase) - 2 * m)
            if stop <= start:
                continue
            middle = phase[start + m : stop + m]
            second = np.add(phase[start:stop], phase[start + 2 * m : stop + 2 * m], out=work[: stop - start])
            second -= middle
            second -= middle
            for at in range(0, len(second), _DOT):
                part = second[at : at + _DOT]
                sums[row] += part @ part
    return np.asarray(sums / factors.astype(np.float64) ** 2)


def _with_gaps(phase: FloatArray, held: IntArray, m: int) -> tuple[float, int]:
    needed = max(1, int(np.ceil(_MIN_COVERAGE * m)))
    pairs, total = 0, 0.0
    for start in range(0, len(phase) - 2 * m, _BLOCK):
        stop = min(start + _BLOCK, len(phase) - 2 * m)
        first, middle, last = (slice(start + k * m, stop + k * m) for k in range(3))
        before, after = held[middle] - held[first], held[last] - held[middle]
        good = (before >= needed) & (after >= needed)
        step = (phase[last] - phase[middle])[good] / after[good] - (phase[middle] - phase[first])[
            good
        ] / before[good]
        total += float(np.einsum("i,i->", step, step))
        pairs += len(step)
    return total, pairs
