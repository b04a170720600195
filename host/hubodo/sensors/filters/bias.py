"""Static bias of a gyro axis from standstills: mean, and the pseudo-measurement filter of Shah et al."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.filters.pseudo_measurement import PseudoMeasurementFilter
from hubodo.sensors.heading.standstill import fill_channels
from hubodo.sensors.heading.standstill_choice import MAX_BIAS
from hubodo.sensors.imu.standstills import find_standstills

Spans = tuple[tuple[int, int], ...]
"""Index of the first sample and one past the last of each standstill."""
_MIN_STANDSTILL_SAMPLES = 32
_MIN_HELD_OUT_SAMPLES = 64
_BLOCKS = 8
_MAX_FILTERED_SAMPLES = 20_000


@dataclass(frozen=True)
class BiasEstimate:
    """A static bias and its error on samples that were not used for it.

    Attributes:
        method: mean, or pseudo-measurement.
        bias, sigma: rad/s.
        held_out: mean of the other standstill samples minus the bias, rad/s; None without such samples.
    """

    method: str
    bias: float
    sigma: float
    held_out: float | None


def find_standstill_spans(t: Array, gyro: Array, accel: Array, samples: Array) -> Spans:
    """Return the standstills of a node; a steady rate larger than any bias is a turn.

    t: (N,) s. gyro, accel: (N, 3), NaN where a channel is not measured. samples: (N,) rad/s, of the axis.
    """
    try:
        standstills = find_standstills(t, *fill_channels(samples, gyro, accel))
    except CalibrationError:
        return ()
    return tuple(
        (int(i), int(j))
        for i, j in zip(standstills.start, standstills.end, strict=True)
        if abs(float(samples[i:j].mean())) <= MAX_BIAS
    )


def spans_of_times(t: Array, times: Sequence[Sequence[float]]) -> Spans:
    """Return the index ranges of standstills that the user gave; raise InputError for too few samples."""
    spans = []
    for first, last in times:
        i, j = np.searchsorted(t, [first, last]).tolist()
        if j - i < _MIN_STANDSTILL_SAMPLES:
            raise InputError(
                f"--rest {first:g} {last:g}: holds {max(j - i, 0)} samples, which are too few; the log is "
                f"from {t[0]:.6g} to {t[-1]:.6g} s"
            )
        spans.append((i, j))
    return tuple(spans)


def estimate_static_biases(gyro: Array, axis: int, spans: Spans) -> tuple[BiasEstimate, ...]:
    """Return the bias of an axis by each method, from the first half of the standstill samples.

    gyro: (N, 3) rad/s, NaN where an axis is not measured. The pseudo-measurement needs all three axes; at
    standstill the known magnitude of the rate is zero.
    """
    samples = np.concatenate([gyro[i:j] for i, j in spans])
    half = len(samples) // 2 if len(samples) >= _MIN_HELD_OUT_SAMPLES else len(samples)
    fitted, held_out = samples[:half], samples[half:, axis]
    means = np.array([part.mean() for part in np.array_split(fitted[:, axis], _BLOCKS)])
    # Means of blocks, because drift and coloured noise do not average out like white noise.
    sigma = float(means.std(ddof=1)) / math.sqrt(_BLOCKS)
    estimates = [("mean", float(fitted[:, axis].mean()), sigma)]
    if np.isfinite(fitted).all() and (np.ptp(fitted, axis=0) > 0.0).all():
        used = fitted[:_MAX_FILTERED_SAMPLES]
        # The first sample is the initial bias; its sigma is that of the noise.
        bias_filter = PseudoMeasurementFilter(np.cov(used.T), used[0], used.std(axis=0, ddof=1))
        bias_filter.run(used[1:])
        sigma = math.sqrt(float(bias_filter.covariance[axis, axis]))
        estimates.append(("pseudo-measurement", bias_filter.bias[axis], sigma))
    return tuple(
        BiasEstimate(method, bias, sigma, float(held_out.mean()) - bias if len(held_out) else None)
        for method, bias, sigma in estimates
    )
