"""Correlation of the noise of each channel, from residuals: within a window and from window to window.

Vibration, tyres and the low-pass filter of a sensor colour the noise of a real drive. White weights then
waste what is visible between its spectral lines, and exaggerate what is visible at them. Generalised least
squares with the covariance of the noise is the best linear estimate (Aitken 1935).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular, toeplitz

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.process_noise import compute_carrier
from hubodo.gap.process_noise.segments import find_standing_windows, window_edges, window_grid
from hubodo.gap.process_noise.slow_noise import SlowComponent, estimate_slow_noise
from hubodo.gap.process_noise.weights import Carrier, NoiseCorrelation, SlowNoise
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION
from hubodo.gap.process_noise.window_sums import winsorise
from hubodo.gap.state.state import State

# Samples in a window, and windows of a channel, below which no correlation is estimated; ratio of the longest
# window to the usual one above which samples are not evenly spaced.
_MIN_WINDOW_SAMPLES, _MIN_WINDOWS, _MAX_LENGTH_RATIO = 8, 10, 1.5
# Share of white noise that bounds the condition of a covariance.
_WHITE_SHARE = 1e-6
# Largest share of the slow noise in the variance along any direction of a window.
_MAX_SLOW_SHARE = 0.9
# Half a turn within a window, rad/s; below it carriers of the wheel angle are hardly distinct.
_MIN_CARRIER_SPIN = np.pi / WINDOW_DURATION
_CARRIERS: tuple[Carrier, ...] = ("constant", "cosine", "sine")
_N_SPINS = 10


def correlate_noise(evaluation: Evaluation) -> Evaluation:
    """Return an evaluation under weights with the correlation of the noise, as far as it is significant."""
    plain = replace(evaluation, weights=replace(evaluation.weights, correlations={}))
    residuals, correlations = plain.mean_residuals, {}
    for node in evaluation.problem.nodes:
        z = winsorise(residuals[node.name].value * plain.weigh(node))
        correlation = _estimate_correlation(z, plain, node)
        if correlation is not None:
            correlations[node.name] = correlation
    return replace(evaluation, weights=replace(evaluation.weights, correlations=correlations))


def _estimate_correlation(z: Array, evaluation: Evaluation, node: NodeData) -> NoiseCorrelation | None:
    """Return the correlation of the noise of a node; None if it is white, or too little is known.

    z: (6, N) residuals in sigma, zero for excluded samples
    """
    windows = _Windows.split(evaluation.state, node)
    counts = np.count_nonzero(z, axis=1)
    is_sufficient = counts >= _MIN_WINDOWS * windows.length
    if windows.length < _MIN_WINDOW_SAMPLES or not windows.is_even or not is_sufficient.any():
        return None
    shapes = _list_effect_shapes(evaluation.state, node)
    sigmas = np.median(evaluation.weights.noise[node.name].sigma, axis=1)
    whitening, evidence = np.tile(np.eye(windows.length), (2, 6, 1, 1)), 0.0
    slow_noise: list[SlowNoise] = []
    for row in np.flatnonzero(is_sufficient).tolist():
        noise = _remove_shapes(z[row], shapes)
        standing = np.where(windows.is_sample_standing, noise, 0.0)
        if np.count_nonzero(standing) >= _MIN_WINDOWS * windows.length:
            whitening[1, row], _, gain = _whiten(standing, windows.length)
            evidence += gain
        noise = np.where(windows.is_sample_standing, 0.0, noise)
        if np.count_nonzero(noise) < _MIN_WINDOWS * windows.length:
            continue
        white, covariance, gain = _whiten(noise, windows.length)
        evidence += gain
        components = estimate_slow_noise(windows.stack(noise), windows.carriers, windows.is_turning, white)
        components, slow_covariance = _limit_slow_noise(components, white, windows)
        whitening[0, row] = _invert_factor(covariance - slow_covariance) if components else white
        slow_noise += [
            SlowNoise(row, _CARRIERS[one.carrier], one.sigma * float(sigmas[row]), one.correlation_time)
            for one in components
        ]
    return NoiseCorrelation(whitening, tuple(slow_noise)) if evidence > 0.0 else None


@dataclass(frozen=True)
class _Windows:
    """Windows of a node, padded to the longest.

    indices: (K, M) sample of each place; places beyond the end of a window hold the last sample
    is_inside: (K, M), False for these places
    carriers: (3, K, M) waves of the wheel angle, zero beyond the end
    is_turning: (K,), True if the wheel turns fast enough to tell the waves apart
    is_sample_standing: (N,), True for the samples of windows in which the wheel stands
    spins: (S,) rad/s, typical ones of a turning wheel; empty for a node on the body
    period: s, of the samples
    """

    indices: NDArray[np.intp]
    is_inside: NDArray[np.bool_]
    carriers: Array
    is_turning: NDArray[np.bool_]
    is_sample_standing: NDArray[np.bool_]
    spins: Array
    period: float

    @property
    def length(self) -> int:
        return int(self.indices.shape[1])

    @property
    def is_even(self) -> bool:
        """Return True if the windows have about the same number of samples, as those of a steady rate."""
        return self.length <= _MAX_LENGTH_RATIO * float(np.median(self.is_inside.sum(axis=1)))

    def stack(self, values: Array) -> Array:
        """Return values, (N,), by window, (K, M); zero beyond the end of a window."""
        return values[self.indices] * self.is_inside

    @staticmethod
    def split(state: State, node: NodeData) -> _Windows:
        """Return the windows of a node."""
        edges = window_edges(window_grid(state.problem), node)
        places = edges[:-1, None] + np.arange(int(np.diff(edges).max()))
        is_inside = np.asarray(places < edges[1:, None])
        indices = np.minimum(places, len(node.t) - 1)
        waves = [compute_carrier(state, node, carrier)[indices] * is_inside for carrier in _CARRIERS]
        rolling = state.predictions[node.name].rolling
        spin = np.zeros(len(node.t)) if rolling is None else np.abs(rolling.spin)
        mean_spin = (spin[indices] * is_inside).sum(axis=1) / np.maximum(is_inside.sum(axis=1), 1)
        is_turning = np.asarray(mean_spin > _MIN_CARRIER_SPIN)
        spins = (
            np.quantile(mean_spin[is_turning], np.linspace(0.05, 0.95, _N_SPINS)) if is_turning.any() else []
        )
        period = float(np.median(np.diff(node.t)))
        is_standing = np.repeat(find_standing_windows(node, edges), np.diff(edges))
        return _Windows(indices, is_inside, np.array(waves), is_turning, is_standing, np.array(spins), period)


def _limit_slow_noise(
    components: Sequence[SlowComponent], whitening: Array, windows: _Windows
) -> tuple[list[SlowComponent], Array]:
    """Return the slow noise of a channel and its share of the covariance of a window, (M, M).

    whitening: of the whole noise. Along no direction may more than a share of the variance be slow, so that
        what is left is positive definite
    """
    lags = np.arange(windows.length) * windows.period
    slow = np.zeros(windows.length)
    for one in components:
        # Cosine and sine have half a wave each.
        is_wave = one.carrier > 0
        slow += one.sigma**2 * (0.5 * np.cos(np.outer(windows.spins, lags)).mean(axis=0) if is_wave else 1.0)
    covariance = toeplitz(slow)
    largest = float(np.linalg.eigvalsh(whitening @ covariance @ whitening.T)[-1])
    factor = min(1.0, _MAX_SLOW_SHARE / max(largest, 1e-12))
    scaled = [replace(one, sigma=one.sigma * float(np.sqrt(factor))) for one in components]
    return scaled, factor * covariance


def _whiten(noise: Array, length: int) -> tuple[Array, Array, float]:
    """Return whitening and covariance, (M, M) each, of the noise of a channel, and ln evidence for them."""
    count = int(np.count_nonzero(noise))
    covariance = toeplitz(_compute_autocovariance(noise, length, count))
    whitening = _invert_factor(covariance)
    return whitening, covariance, _compute_evidence(float(covariance[0, 0]), whitening, count)


def _invert_factor(covariance: Array) -> Array:
    """Return the lower triangular matrix that whitens noise of a covariance, (M, M)."""
    return np.asarray(solve_triangular(np.linalg.cholesky(covariance), np.eye(len(covariance)), lower=True))


def _compute_evidence(variance: float, whitening: Array, count: int) -> float:
    """Return the ln Bayes factor of correlated over white noise of a channel with `count` samples, by BIC."""
    length = len(whitening)
    gain = 0.5 * length * np.log(variance) + float(np.log(whitening.diagonal()).sum())
    return float(count / length * gain - 0.5 * length * np.log(count))


def _compute_autocovariance(noise: Array, length: int, count: int) -> Array:
    """Return the autocovariance, (length,), of noise, which is zero where it is unknown.

    The biased estimate from the whole log is positive definite.
    """
    spectrum = np.abs(np.fft.rfft(noise, 1 << (len(noise) + length).bit_length())) ** 2
    autocovariance = np.fft.irfft(spectrum)[:length] / count
    autocovariance[0] *= 1.0 + _WHITE_SHARE
    return np.asarray(autocovariance)


def _remove_shapes(z: Array, shapes: Array) -> Array:
    """Return the residuals of a channel, (N,), without what missing effects leave in them."""
    is_used, noise = z != 0.0, np.zeros_like(z)
    used_shapes = shapes[is_used]
    noise[is_used] = z[is_used] - used_shapes @ np.linalg.lstsq(used_shapes, z[is_used])[0]
    return noise


def _list_effect_shapes(state: State, node: NodeData) -> Array:
    """Return the shapes, (N, S), that missing effects leave in a channel: motion times waves of the angle.

    Fitted over the whole log they take hardly any noise with them, while shapes fitted to each second would
    take all of its slow part.
    """
    reading = state.predictions[node.name]
    t, one = (node.t - node.t[0]) / max(float(np.ptp(node.t)), 1e-9), np.ones(len(node.t))
    speed, yaw_rate = (np.broadcast_to(x, one.shape) for x in (reading.body.speed, reading.body.yaw_rate))
    if reading.rolling is None:
        motion, waves = [one, speed, yaw_rate, speed * yaw_rate, np.gradient(speed, node.t)], [one]
    else:
        spin, angle = reading.rolling.spin, reading.rolling.angle
        motion = [one, spin, spin**2, np.gradient(spin, node.t), yaw_rate]
        waves = [one, *(wave(k * angle) for k in (1.0, 2.0) for wave in (np.cos, np.sin))]
    shapes = np.stack([*(x * wave for x in motion for wave in waves), t, t * t], axis=1)
    return np.asarray(shapes / np.maximum(np.linalg.norm(shapes, axis=0), 1e-12))
