"""Effects of chance: power of the best test of known size, drawn from the simulator's own noise.

The statistic is the ln likelihood ratio T of the effect at its size against nothing (Neyman and Pearson
1933), drawn where the effect is there. Where it is not, T exceeds t as often as e^-T [T > t] is in the mean
of these same draws, so that thresholds of rare false alarms need no rare draws.

No other effect makes readings isolated, stale, clipped or quantised: these are chosen among their scopes, by
    likelihoods of each node that do not know the effect's numbers. For the walk see `oracle.py`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import logsumexp
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
# What the numbers of a name could be, for whoever does not know them.
_SHARES, _SIZES = np.geomspace(1e-5, 0.1, 13), np.linspace(2.5, 8.0, 6)


def threshold(drawn: Array, alarm: float) -> float:
    """Return the value that T exceeds with probability `alarm` without the effect.

    drawn: (R,) of T with the effect
    """
    ordered = np.sort(drawn)[::-1]
    exceeded = np.cumsum(np.exp(np.clip(-ordered, -700.0, 700.0))) / len(ordered)
    beyond = np.flatnonzero(exceeded > alarm)
    return float(ordered[beyond[0]]) if len(beyond) else float(ordered[-1]) - 1.0


def statistic(setup: Setup, meter: Meter, effect: Effect, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return draws of T, (DRAWS,), over all nodes concerned, and whether its scope is chosen."""
    total, beside = np.zeros(DRAWS), dict[str, Array]()
    for node in SIDES:
        clean, sigma = meter.readings(node)
        interval = float(np.mean(np.diff(setup.taken[node])))
        made, beside[node] = _of_node(effect, effect.concerns(node), clean, sigma, interval, rng)
        total += made
    return total, _scope_chosen(effect, beside)


def _scope_chosen(effect: Effect, beside: Mapping[str, Array]) -> Array:
    """Return True if its scope is more probable than the others together.

    beside: of each node (DRAWS, K), ln likelihood ratio of the effect with each of K numbers that it could
        have, as likely as each other beforehand, against its absence there. `all`: the same numbers on all
        nodes.
    """
    scores = {node: logsumexp(each, axis=1) for node, each in beside.items()}
    scores["all"] = logsumexp(sum(beside.values()), axis=1)
    whole = logsumexp(list(scores.values()), axis=0)
    # The sum loses digits: what is just one half is not more.
    return np.asarray(scores[effect.scope] - whole > np.log(0.5) + 1e-9)


def _of_node(
    effect: Effect, there: bool, clean: Array, sigma: Array, interval: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """T of a node, nothing where the effect is not there, and what `_scope_chosen` asks for.

    clean, sigma: (n, 6) of the node. interval: s between samples.
    """
    parameters = effect.parameters
    match effect.name:
        case "gyro_quantization":
            made = sum(_wider(parameters["step"], one, rng) for one in sigma[:, :3].T)
            return (made, _certain(there)) if there else (np.zeros(DRAWS), _certain(there))
        case "gyro_rate_random_walk":
            made = sum(_walk(parameters["k"], one, interval, rng) for one in sigma[:, :3].T)
            return (made, _certain(there)) if there else (np.zeros(DRAWS), _certain(there))
        case "outliers":
            return _mixture(parameters["probability"] * there, parameters["sigma"], clean.size, rng)
        case "sample_repeat":
            return _stale(parameters["probability"] * there, clean, sigma, rng)
        case "gyro_saturation":
            return _clipped(parameters["limit"], there, clean[:, :3], sigma[:, :3], GYRO_LSB, rng)
    return _clipped(parameters["limit"], there, clean[:, 3:], sigma[:, 3:], ACCEL_LSB, rng)


def _certain(there: bool) -> Array:
    """Return (DRAWS, 1) draws of an effect whose presence is certain."""
    return np.full((DRAWS, 1), 1e3 if there else -1e3)


def _wider(step: float, sigma: Array, rng: np.random.Generator) -> Array:
    """Return draws of noise widened by rounding; the lattice itself is no effect, as every chip has one."""
    ratio = 1.0 + max(step**2 - GYRO_LSB**2, 0.0) / 12.0 / float(np.mean(sigma**2))
    squares = rng.chisquare(len(sigma), DRAWS)
    return 0.5 * ((ratio - 1.0) * squares - len(sigma) * np.log(ratio))


def _walk(k: float, sigma: Array, interval: float, rng: np.random.Generator) -> Array:
    """Return draws of white noise with a walk, by modes.

    Eigenvalues: 1 / (4 sin²((2 j - 1) π / (4 n + 2))).
    """
    j, n = np.arange(1, _WAVES + 1), len(sigma)
    spread = 1.0 / (4.0 * np.sin((2.0 * j - 1.0) * np.pi / (4.0 * n + 2.0)) ** 2)
    more = k**2 * interval * spread * np.mean(sigma**-2.0)
    squares = rng.standard_normal((DRAWS, _WAVES)) ** 2
    return 0.5 * (squares @ more - np.sum(np.log1p(more)))


def _mixture(probability: float, size: float, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return draws of (1 - p) N(0, 1) + p N(0, 1 + size²) against N(0, 1), from counts in bins of size."""
    edges = np.concatenate([np.linspace(0.0, 6.0, 121), np.linspace(6.2, 60.0, 120), [np.inf]])
    own = -np.diff(norm.sf(edges))

    def far(size: float) -> Array:
        return np.asarray(-np.diff(norm.sf(edges / np.hypot(1.0, size))))

    def ratio(probability: float, far: Array) -> Array:
        # The last of the likelihood of nothing is less than a float can say, and no reading falls there.
        return np.log1p(probability * (far / np.maximum(own, 1e-290) - 1.0))

    mixed = 2.0 * ((1.0 - probability) * own + probability * far(size))
    drawn = rng.multinomial(count, mixed / mixed.sum(), DRAWS)
    numbers = [ratio(one, far(other)) for one in _SHARES for other in _SIZES]
    return drawn @ ratio(probability, far(size)), drawn @ np.array(numbers).T


def _stale(probability: float, clean: Array, sigma: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return draws of samples equal to their predecessor, against their natural frequency."""
    moved = np.diff(clean, axis=0) / sigma[1:]
    by_chance = np.sum(np.log(LSB / (2.0 * np.sqrt(np.pi) * sigma[1:])) - 0.25 * moved**2, 1)
    hits = rng.binomial(len(by_chance), probability, DRAWS) if probability else np.zeros(DRAWS, int)
    # That a sample is stale is as good as certain: of each share only its power of the hits is left.
    missed = len(by_chance) - hits
    surely = np.median(-by_chance) * hits
    beside = surely[:, None] + hits[:, None] * np.log(_SHARES) + missed[:, None] * np.log1p(-_SHARES)
    if not probability:
        return np.zeros(DRAWS), beside
    each = np.logaddexp(np.log(probability) - by_chance, np.log1p(-probability))
    made = missed * np.log1p(-probability)
    return made + np.array([np.sum(rng.choice(each, one)) for one in np.maximum(hits, 1)]), beside


def _clipped(
    limit: float, there: bool, clean: Array, sigma: Array, lsb: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return draws of clipped values, which stand for the whole tail beyond the limit.

    A node without the effect shows that it has none by a reading beyond the limit.
    """
    z = ((limit - np.abs(clean)) / sigma).ravel()
    beyond = norm.logsf(z)
    close = beyond > np.log(1e-7)
    z, beyond, sigma = z[close], beyond[close], sigma.ravel()[close]
    each = np.maximum(beyond - norm.logpdf(z) - np.log(lsb / sigma), 0.0)
    made, hits = np.zeros(DRAWS), np.zeros(DRAWS)
    for first in range(0, len(z), 500):
        part = slice(first, first + 500)
        hit = rng.random((DRAWS, len(z[part]))) < np.exp(beyond[part])
        made, hits = made + hit @ each[part], hits + np.count_nonzero(hit, axis=1)
    return (made, made[:, None]) if there else (np.zeros(DRAWS), np.where(hits > 0, -1e3, 0.0)[:, None])
