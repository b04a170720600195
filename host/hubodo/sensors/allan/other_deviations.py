"""Modified Allan, Hadamard and total deviation, and power spectral density (NIST SP 1065) of a record."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.allan.deviation import averaging_factors
from hubodo.sensors.even_grid import EvenGrid

_MAX_FILLED_SAMPLES = 3
_SEGMENTS = 16
"""Segments of the spectral density, overlapping by half: its sigma is about a fifth."""


def deviation(record: EvenGrid, kind: str) -> tuple[Array, Array]:
    """Return averaging times, (P,) s, and a deviation, (P,) in the unit of the record.

    kind: one of `DEVIATIONS`. Only the longest span without gaps of more than three samples is used. Raises
    InputError for an unknown kind or too short a span.
    """
    if kind not in DEVIATIONS:
        raise InputError(f"deviation {kind!r}: choose from {', '.join(DEVIATIONS)}")
    values = longest_span(record)
    phase = np.concatenate(([0.0], np.cumsum(values - values.mean()))) * record.dt
    compute, windows = DEVIATIONS[kind]
    factors = [int(m) for m in averaging_factors(len(values)) if windows * m < len(phase)]
    tau = np.array(factors) * record.dt
    variance = np.array([compute(phase, m) for m in factors]) / tau**2
    return tau, np.sqrt(variance)


def spectral_density(record: EvenGrid) -> tuple[Array, Array]:
    """Return frequencies, (F,) Hz, and the one-sided root density, (F,) unit/√Hz, by Welch's method."""
    from scipy.signal import welch

    values = longest_span(record)
    frequency, density = welch(values, 1.0 / record.dt, nperseg=max(8, 2 * len(values) // (_SEGMENTS + 1)))
    return np.asarray(frequency[1:], np.float64), np.sqrt(density[1:])


def longest_span(record: EvenGrid) -> Array:
    """Return the samples of the longest span in which at most three neighbours are missing, interpolated.

    Raises InputError if it has fewer than eight samples.
    """
    present = np.flatnonzero(record.present)
    if not len(present):
        raise InputError("the record holds no samples")
    breaks = np.flatnonzero(np.diff(present) > _MAX_FILLED_SAMPLES + 1)
    starts, ends = np.concatenate(([0], breaks + 1)), np.concatenate((breaks, [len(present) - 1]))
    best = int(np.argmax(present[ends] - present[starts]))
    first, last = int(present[starts[best]]), int(present[ends[best]])
    if last - first < 7:
        raise InputError("the record has no span of eight samples without gaps; record again")
    index = np.arange(first, last + 1)
    return np.asarray(np.interp(index, present, record.values[present]), np.float64)


def _modified(phase: Array, m: int) -> float:
    """Return the modified Allan variance times tau² (eq. 14)."""
    second = phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]
    total = np.concatenate(([0.0], np.cumsum(second)))
    means = (total[m:] - total[:-m]) / m
    return float(means @ means) / (2.0 * len(means))


def _hadamard(phase: Array, m: int) -> float:
    """Return the overlapping Hadamard variance times tau² (eq. 17)."""
    third = phase[3 * m :] - 3.0 * phase[2 * m : -m] + 3.0 * phase[m : -2 * m] - phase[: -3 * m]
    return float(third @ third) / (6.0 * len(third))


def _total(phase: Array, m: int) -> float:
    """Return the total variance times tau² (eq. 21), of the record reflected about its ends."""
    before = 2.0 * phase[0] - phase[m:0:-1]
    after = 2.0 * phase[-1] - phase[-2 : -m - 2 : -1]
    extended = np.concatenate((before, phase, after))
    second = extended[: -2 * m] - 2.0 * extended[m:-m] + extended[2 * m :]
    inner = second[1:-1]
    return float(inner @ inner) / (2.0 * len(inner))


DEVIATIONS: MappingProxyType[str, tuple[Callable[[Array, int], float], int]] = MappingProxyType(
    {"modified": (_modified, 3), "hadamard": (_hadamard, 3), "total": (_total, 1)}
)
"""Variance times tau², and number of windows that have to fit into the record, by name."""
