"""Likelihood of the bias of a vertical gyro from gravity and Earth rate.

    y_i = y0 + y1 t_i + c1 w_i + c2 w_i² + C cos(h_i) + S sin(h_i) + noise_i,  h_i = integral of (rate - b)

y is a horizontal accelerometer or gyro axis, w the rate, h the heading. On a table that is not exactly level
the horizontal part of gravity turns with the heading, as the horizontal Earth rate always does. c1 is the
cross-axis sensitivity, c2 the distance from the turning axis. Only the true bias b gives the true heading.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import logsumexp

from hubodo.arrays import Array

_EVIDENCE_BLOCK_S = 1.0
_MAX_DURATION_S = 600.0
"""The bias drifts too far in a longer record to give one heading."""
_MIN_BLOCKS = 20
_SCALE_ERRORS = np.linspace(-0.02, 0.02, 9)
_SCALE_ERROR_SIGMA = 0.01
"""Errors of the gyro's scale that are tried, and their 1σ: 1 % of a turn of 700 degrees is 7 degrees."""
_PHASE_STEP = 0.1
"""Step of the heading at the end of the record, rad, between neighbouring biases."""
_BIAS_SMOOTHING = np.radians(0.01)
"""Bias instability, rad/s, by which the likelihood is smoothed."""
_BIAS_CHUNK = 500
_LEAST_POWER = 1e-18
"""Sum of squares, in SI units, below which a channel is constant."""


def turn_evidence(
    t: Array,
    rate: Array,
    triads: Sequence[tuple[Array, float]],
    spans: list[tuple[int, int]],
    max_bias: float,
) -> Callable[[Array], Array] | None:
    """Return the log likelihood of a bias as a function of (M,) biases, rad/s; None for a short record.

    t: (N,) s. rate: (N,) about the vertical, rad/s. triads: the horizontal channels (N, C) of gyro and
    accelerometer, with the usual amplitude of the component that rotates with the heading. spans: index
    ranges with a
    constant rate. max_bias: rad/s.
    """
    step = float(np.median(np.diff(t)))
    width = max(1, round(_EVIDENCE_BLOCK_S / step))
    starts = np.array(
        [a for i, j in spans for a in range(i, j - width + 1, width) if t[a] - t[0] <= _MAX_DURATION_S], int
    )
    if len(starts) < _MIN_BLOCKS:
        return None
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    times = _block_means(t, starts, width) - t[0]
    angle, spin = _block_means(turned, starts, width), _block_means(rate, starts, width)
    scaled_spin = spin / max(float(np.abs(spin).max()), 1e-9)
    fixed = np.column_stack([np.ones(len(times)), times / times[-1], scaled_spin, scaled_spin**2])
    basis = np.linalg.qr(fixed)[0]
    duration = float(times[-1])
    biases = np.arange(-max_bias, max_bias, _PHASE_STEP / duration)
    columns = [
        (_project(_block_means(channel, starts, width), basis), amplitude, triad)
        for triad, (channels, amplitude) in enumerate(triads)
        for channel in channels.T
    ]
    columns = [column for column in columns if float(column[0] @ column[0]) > _LEAST_POWER]
    if not columns:
        return None
    y = np.column_stack([column[0] for column in columns])
    parts = []
    for scale_error in _SCALE_ERRORS:
        factors = np.zeros((len(triads), len(biases)))
        scaled = angle / (1.0 + scale_error)
        explained = _explained_power(y, basis, scaled, times, biases)
        for k, (values, amplitude, triad) in enumerate(columns):
            best = float(biases[explained[k].argmax()])
            noise = _residual_noise(values, basis, scaled, times, best)
            factors[triad] += _log_bayes_factor(explained[k], len(times), noise, amplitude)
        # Prior: with probability one half a table is so level that nothing turns visibly, and no bias is
        # preferred.
        visible = np.sum(np.logaddexp(0.0, factors) - np.log(2.0), axis=0)
        parts.append(visible - 0.5 * (scale_error / _SCALE_ERROR_SIGMA) ** 2)
    smoothed = _smooth(np.asarray(logsumexp(parts, axis=0)), float(biases[1] - biases[0]))
    return lambda values: np.interp(values, biases, smoothed)


def _project(values: Array, basis: Array) -> Array:
    """Return the values minus their projection onto the columns of an orthonormal basis."""
    return np.asarray(values - basis @ (basis.T @ values))


def _block_means(values: Array, starts: Array, width: int) -> Array:
    sums = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    return np.asarray((sums[starts + width] - sums[starts]) / width + values.mean())


def _log_bayes_factor(explained: Array, rows: int, noise: tuple[float, float], amplitude: float) -> Array:
    """Return the (M,) log Bayes factors of a wave that turns with the heading, against none, at each bias.

    The amplitude of the wave has a Gaussian prior, so noise alone prefers no wave. explained: (M,) sums of
    squares of `rows` values that a wave explains. noise: number and variance of independent residuals.
    """
    count, variance = noise
    prior_ratio = amplitude**2 * 0.5 * count / variance
    signal = explained / variance * count / rows
    return np.asarray(0.5 * prior_ratio / (1.0 + prior_ratio) * signal - np.log1p(prior_ratio))


def _explained_power(y: Array, basis: Array, angle: Array, times: Array, biases: Array) -> Array:
    """Return the (C, M) sums of squares of y (N, C) that a wave with the heading explains at each bias."""
    explained = np.empty((y.shape[1], len(biases)))
    for first in range(0, len(biases), _BIAS_CHUNK):
        heading = angle[:, None] - times[:, None] * biases[first : first + _BIAS_CHUNK]
        cos, sin = (_project(wave, basis) for wave in (np.cos(heading), np.sin(heading)))
        cc, ss = (np.einsum("nm,nm->m", wave, wave) + 1e-3 for wave in (cos, sin))
        cs = np.einsum("nm,nm->m", cos, sin)
        cy, sy = y.T @ cos, y.T @ sin
        power = (ss * cy**2 - 2 * cs * cy * sy + cc * sy**2) / np.maximum(cc * ss - cs**2, 1e-9)
        explained[:, first : first + _BIAS_CHUNK] = power
    return np.asarray(np.minimum(explained, np.sum(y**2, axis=0)[:, None]))


def _residual_noise(y: Array, basis: Array, angle: Array, times: Array, bias: float) -> tuple[float, float]:
    """Return number and variance of independent residuals, at the bias that explains most."""
    heading = angle - times * bias
    design = np.column_stack([basis, np.cos(heading), np.sin(heading)])
    residual = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    power = float(residual @ residual)
    correlation = max(0.0, float(residual[1:] @ residual[:-1]) / power) if power else 0.0
    count = len(y) * (1.0 - correlation) / (1.0 + correlation)
    return max(count, 1.0), max(power / max(1, len(y) - design.shape[1]), 1e-300)


def _smooth(log_likelihood: Array, step: float) -> Array:
    """Return the log of the likelihood convolved with the Gaussian of the bias instability."""
    half = max(1, round(4.0 * _BIAS_SMOOTHING / step))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) * step / _BIAS_SMOOTHING) ** 2)
    top = float(log_likelihood.max())
    likelihood = np.convolve(np.exp(log_likelihood - top), kernel / kernel.sum(), mode="same")
    return np.asarray(np.log(likelihood + 1e-300) + top)
