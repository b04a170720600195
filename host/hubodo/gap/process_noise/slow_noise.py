"""Noise that lasts longer than a window: Gauss-Markov processes, from estimates of consecutive windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION

# Windows between which correlation is measured, and correlation times to choose from, s.
_LAGS, _CORRELATION_TIMES = np.arange(1, 9), (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
# The first lags decide whether noise is slow: their sum, in sigma of that of white noise.
_N_DECISIVE_LAGS, _MIN_SLOW_SIGMA = 4, 2.0
# Pairs of windows below which nothing is estimated; limit of a window's estimate, in sigma; largest share of
# slow noise in its variance.
_MIN_PAIRS, _MAX_SIGMA, _MAX_SHARE = 20, 4.0, 0.9
# Share of a window's samples that must be known.
_MIN_KNOWN_SHARE = 0.5
# Carriers with one process each: constant; cosine and sine.
_GROUPS = ((0,), (1, 2))


@dataclass(frozen=True)
class SlowComponent:
    """Slow noise of one carrier: 1 sigma, in units of the noise, and correlation time, s."""

    carrier: int
    sigma: float
    correlation_time: float


def estimate_slow_noise(
    noise: Array, carriers: Array, is_turning: NDArray[np.bool_], whitening: Array
) -> list[SlowComponent]:
    """Return the slow noise of a channel.

    noise: (K, M) in each window, zero where it is unknown
    carriers: (3, K, M) constant, cosine and sine of the wheel angle
    is_turning: (K,), False where cosine and sine are not distinct from the constant
    whitening: (M, M) matrix that makes the noise white within a window
    """
    amplitudes, variances = _estimate_amplitudes(noise, carriers, is_turning, whitening)
    components = []
    for group in _GROUPS:
        correlation, pairs = _correlate_windows([amplitudes[:, k] / np.sqrt(variances[:, k]) for k in group])
        decisive = correlation[:_N_DECISIVE_LAGS]
        if pairs < _MIN_PAIRS or decisive.sum() < _MIN_SLOW_SIGMA * np.sqrt(len(decisive) / pairs):
            continue
        share, time = _fit_decay(correlation)
        variance = float(np.nanmedian(variances[:, group]))
        components += [SlowComponent(k, float(np.sqrt(share * variance)), time) for k in group]
    return components


def _estimate_amplitudes(
    noise: Array, carriers: Array, is_turning: NDArray[np.bool_], whitening: Array
) -> tuple[Array, Array]:
    """Return amplitude and variance of each carrier, (K, 3) each, by generalised least squares per window."""
    is_known = noise != 0.0
    white_noise = (noise @ whitening.T) * is_known
    white_carriers = (carriers @ whitening.T) * is_known
    amplitudes, variances = np.full((2, len(noise), 3), np.nan)
    is_used = is_known.mean(axis=1) > _MIN_KNOWN_SHARE
    for count, windows in ((3, is_used & is_turning), (1, is_used & ~is_turning)):
        x = white_carriers[:count, windows]
        information = np.einsum("ikm,jkm->kij", x, x)
        score = np.einsum("ikm,km->ki", x, white_noise[windows])
        inverse = np.linalg.pinv(information, hermitian=True)
        amplitudes[windows, :count] = np.einsum("kij,kj->ki", inverse, score)
        variances[windows, :count] = np.maximum(np.einsum("kii->ki", inverse), 1e-12)
    return amplitudes, variances


def _correlate_windows(series: Sequence[Array]) -> tuple[Array, int]:
    """Return the mean products of windows at each lag, and the number of neighbouring pairs.

    series: (K,) each, in sigma, nan where they are unknown
    """
    total, count = np.zeros((2, len(_LAGS)))
    for one in series:
        limited = np.clip(one, -_MAX_SIGMA, _MAX_SIGMA)
        for k, lag in enumerate(_LAGS):
            products = limited[:-lag] * limited[lag:]
            is_known = np.isfinite(products)
            total[k] += products[is_known].sum()
            count[k] += np.count_nonzero(is_known)
    return total / np.maximum(count, 1.0), int(count[0])


def _fit_decay(correlation: Array) -> tuple[float, float]:
    """Return share and correlation time, s, of the Gauss-Markov process closest to a correlation."""
    fits = []
    for time in _CORRELATION_TIMES:
        decay = np.exp(-_LAGS * WINDOW_DURATION / time)
        share = float(np.clip(correlation @ decay / (decay @ decay), 0.0, _MAX_SHARE))
        fits.append((float(np.sum((correlation - share * decay) ** 2)), share, time))
    return min(fits)[1:]
