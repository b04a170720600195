"""Effects of chance: what the best test of one of known size would see, drawn from the generator's own noise.

The statistic is the ln likelihood ratio T of the effect at its size against nothing (Neyman and Pearson
1933), drawn where the effect is there. Where it is not, T exceeds t as often as e^-T [T > t] is in the mean
of these same draws, so that thresholds of rare false alarms need no rare draws.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from gap_matrix.cases import Setup
from gap_matrix.dose import LSB, Meter
from gap_matrix.effects import SIDES, Effect
from gap_matrix.sensor import ACCEL_LSB, GYRO_LSB
from gap_matrix.world import Array

EFFECTS = (
    "gyro_rate_random_walk", "gyro_quantization", "sample_repeat", "outliers", "gyro_saturation",
    "accel_saturation",
)  # fmt: skip
DRAWS = 1000
# Slowest waves of a walk that are kept: the others have nothing to tell.
_WAVES = 150


def threshold(drawn: Array, alarm: float) -> float:
    """The t that T exceeds with chance `alarm` where nothing is there; drawn: (R,) of T where it is."""
    ordered = np.sort(drawn)[::-1]
    exceeded = np.cumsum(np.exp(np.clip(-ordered, -700.0, 700.0))) / len(ordered)
    beyond = np.flatnonzero(exceeded > alarm)
    return float(ordered[beyond[0]]) if len(beyond) else float(ordered[-1]) - 1.0


def statistic(setup: Setup, meter: Meter, effect: Effect, rng: np.random.Generator) -> Array:
    """(DRAWS,) of T, summed over the nodes that the effect concerns."""
    total = np.zeros(DRAWS)
    for node in SIDES:
        if effect.concerns(node):
            clean, sigma = meter.readings(node)
            total += _of_node(effect, clean, sigma, float(np.mean(np.diff(setup.taken[node]))), rng)
    return total


def _of_node(effect: Effect, clean: Array, sigma: Array, interval: float, rng: np.random.Generator) -> Array:
    """clean, sigma: (n, 6) of a node. interval: s between samples."""
    parameters = effect.parameters
    match effect.name:
        case "gyro_quantization":
            return sum(_wider(parameters["step"], one, rng) for one in sigma[:, :3].T)
        case "gyro_rate_random_walk":
            return sum(_walk(parameters["k"], one, interval, rng) for one in sigma[:, :3].T)
        case "outliers":
            return _mixture(parameters["probability"], parameters["sigma"], clean.size, rng)
        case "sample_repeat":
            return _stale(parameters["probability"], clean, sigma, rng)
        case "gyro_saturation":
            return _clipped(parameters["limit"], clean[:, :3], sigma[:, :3], GYRO_LSB, rng)
    return _clipped(parameters["limit"], clean[:, 3:], sigma[:, 3:], ACCEL_LSB, rng)


def _wider(step: float, sigma: Array, rng: np.random.Generator) -> Array:
    """Noise that rounding makes wider; that readings lie on a lattice is no effect, every chip's do."""
    ratio = 1.0 + max(step**2 - GYRO_LSB**2, 0.0) / 12.0 / float(np.mean(sigma**2))
    squares = rng.chisquare(len(sigma), DRAWS)
    return 0.5 * ((ratio - 1.0) * squares - len(sigma) * np.log(ratio))


def _walk(k: float, sigma: Array, interval: float, rng: np.random.Generator) -> Array:
    """White noise with a walk in it, wave by wave: eigenvalues 1 / (4 sin²((2 j - 1) π / (4 n + 2)))."""
    j, n = np.arange(1, _WAVES + 1), len(sigma)
    spread = 1.0 / (4.0 * np.sin((2.0 * j - 1.0) * np.pi / (4.0 * n + 2.0)) ** 2)
    more = k**2 * interval * spread * np.mean(sigma**-2.0)
    squares = rng.standard_normal((DRAWS, _WAVES)) ** 2
    return 0.5 * (squares @ more - np.sum(np.log1p(more)))


def _mixture(probability: float, size: float, count: int, rng: np.random.Generator) -> Array:
    """(1 - p) N(0, 1) + p N(0, 1 + size²) against N(0, 1), readings counted in bins of their size."""
    wide = float(np.hypot(1.0, size))
    edges = np.concatenate([np.linspace(0.0, 6.0, 121), np.linspace(6.2, 6.0 * wide + 6.0, 80), [np.inf]])
    own = -np.diff(norm.sf(edges))
    far = -np.diff(norm.sf(edges / wide))
    # The last of the likelihood of nothing is less than a float can say, and no reading falls there anyhow.
    ratio = np.log1p(probability * (far / np.maximum(own, 1e-290) - 1.0))
    mixed = 2.0 * ((1.0 - probability) * own + probability * far)
    return rng.multinomial(count, mixed / mixed.sum(), DRAWS) @ ratio


def _stale(probability: float, clean: Array, sigma: Array, rng: np.random.Generator) -> Array:
    """Samples equal to their predecessor in all six channels, against how likely that is anyhow."""
    moved = np.diff(clean, axis=0) / sigma[1:]
    by_chance = np.sum(np.log(LSB / (2.0 * np.sqrt(np.pi) * sigma[1:])) - 0.25 * moved**2, 1)
    each = np.logaddexp(np.log(probability) - by_chance, np.log1p(-probability))
    hits = rng.binomial(len(by_chance), probability, DRAWS)
    missed = (len(by_chance) - hits) * np.log1p(-probability)
    return missed + np.array([np.sum(rng.choice(each, one)) for one in np.maximum(hits, 1)])


def _clipped(limit: float, clean: Array, sigma: Array, lsb: float, rng: np.random.Generator) -> Array:
    """A clipped value stands for all that would lie beyond, instead of for one step of the chip."""
    z = ((limit - np.abs(clean)) / sigma).ravel()
    beyond = norm.logsf(z)
    close = beyond > np.log(1e-7)
    z, beyond, sigma = z[close], beyond[close], sigma.ravel()[close]
    each = np.maximum(beyond - norm.logpdf(z) - np.log(lsb / sigma), 0.0)
    made = np.zeros(DRAWS)
    for first in range(0, len(z), 500):
        part = slice(first, first + 500)
        made += (rng.random((DRAWS, len(z[part]))) < np.exp(beyond[part])) @ each[part]
    return made
