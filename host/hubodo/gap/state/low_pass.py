"""Ratio of a gyro's noise in the band of motion to its scatter from sample to sample."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.model.forward import NodeReading

# s, duration of a block, whose median is a value of the band below 15 Hz; blocks in a window of a second.
_BLOCK_DURATION, _WINDOW_BLOCKS = 1.0 / 30.0, 30
_MIN_MEDIAN_SAMPLES = 3
# Ratio up to which noise counts as white: on real drives gyros have 0.8 to 1.4 as recorded, and 1.9 or more
# with a lag of 10 ms.
_MAX_WHITE_RATIO = 1.5
# Mean of |x| for a unit Gaussian.
_MEAN_OF_UNIT_GAUSSIAN = 0.7978846
_MIN_SINGULAR_RATIO = 1e-3


def measure_low_pass_ratios(t: Array, residual: Array, reading: NodeReading) -> Array:
    """Return the ratio of low-frequency to sample-to-sample noise of k channels, (k,); 1 for white noise.

    t: (N,) s
    residual: (k, N)
    reading: prediction of the node, with the angle of its wheel

    A gyro that lags low-passes its noise too. Its samples then scatter less than the noise in the band in
    which effects act, by which they have to be weighted. What a missing effect leaves in a window, a trend
    and harmonics of the wheel's angle, is fitted and removed first.
    """
    size = round(_BLOCK_DURATION / float(np.median(np.diff(t)))) if len(t) > 1 else 0
    count = len(t) // max(size * _WINDOW_BLOCKS, 1)
    if size < _MIN_MEDIAN_SAMPLES or not count:
        return np.ones(len(residual))
    shape = (count, _WINDOW_BLOCKS, size)
    used = count * _WINDOW_BLOCKS * size
    time = t[:used].reshape(shape).mean(axis=-1)
    angle = np.zeros(used) if reading.rolling is None else reading.rolling.angle[:used]
    basis = _orthonormal_basis(time, angle.reshape(shape).mean(axis=-1))
    samples = residual[:, :used]
    blocks = np.median(samples.reshape(-1, *shape), axis=-1) * np.sqrt(size)
    unexplained = blocks - np.einsum("wbi,wci,kwc->kwb", basis, basis, blocks, optimize=True)
    n_free = _WINDOW_BLOCKS - (basis**2).sum(axis=(1, 2))
    in_band = np.sqrt((unexplained**2).sum(axis=-1) / n_free)
    steps = np.abs(np.diff(samples.reshape(-1, count, _WINDOW_BLOCKS * size), axis=-1))
    white = steps.mean(axis=-1) / (_MEAN_OF_UNIT_GAUSSIAN * np.sqrt(2.0))
    ratios = np.median(in_band / np.maximum(white, 1e-12), axis=1)
    return np.where(ratios > _MAX_WHITE_RATIO, ratios, 1.0)


def _orthonormal_basis(time: Array, angle: Array) -> Array:
    """Return an orthonormal basis, (windows, blocks, 9), of a parabola and two harmonics of the angle.

    The amplitude of the first harmonic varies linearly. Vectors that a standing wheel does not show are zero.
    """
    x = (time - time[:, :1]) / (time[:, -1:] - time[:, :1]) * 2.0 - 1.0
    cos, sin = np.cos(angle), np.sin(angle)
    columns = np.stack(
        [np.ones_like(x), x, x * x, cos, sin, x * cos, x * sin, np.cos(2.0 * angle), np.sin(2.0 * angle)], -1
    )
    u, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u * (singular > _MIN_SINGULAR_RATIO * singular[:, :1])[:, None, :])
