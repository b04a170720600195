"""Random effects: power of the most powerful test of known size, from draws of the simulator's noise.

The statistic is the ln likelihood ratio T of the effect at its size against its absence (Neyman and Pearson
1933), drawn with the effect present. Without the effect, P(T > t) is the mean of e^-T [T > t] over the same
draws (importance sampling), so thresholds of rare false alarms need no rare draws.

Outliers, stale samples, clipping and quantization have no alternative names, only alternative scopes: the
scope is selected by marginal likelihoods over a grid of parameters. For the random walk see `oracle.py`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from gap_matrix.cases import Setup
from gap_matrix.dose import CHANNEL_LSB, GainMeter
from gap_matrix.effects import SIDES, Effect
from gap_matrix.sensor import ACCEL_LSB, GYRO_LSB
from gap_matrix.world import Array

RANDOM_EFFECTS = (
    "gyro_rate_random_walk", "gyro_quantization", "sample_repeat", "outliers", "gyro_saturation",
    "accel_saturation",
)  # fmt: skip
N_DRAWS = 1000
# Number of slowest modes of a random walk that are used; faster ones carry no information.
_N_WAVES = 150
# Grids of the parameters of an effect, for likelihoods with unknown parameters.
_PROBABILITY_GRID, _SIZE_GRID = np.geomspace(1e-5, 0.1, 13), np.linspace(2.5, 8.0, 6)


def detection_threshold(statistics: Array, false_alarm: float) -> float:
    """Return the value that T exceeds with probability `false_alarm` without the effect.

    statistics: (R,) draws of T with the effect
    """
    ordered = np.sort(statistics)[::-1]
    exceeded = np.cumsum(np.exp(np.clip(-ordered, -700.0, 700.0))) / len(ordered)
    exceeding = np.flatnonzero(exceeded > false_alarm)
    return float(ordered[exceeding[0]]) if len(exceeding) else float(ordered[-1]) - 1.0


def draw_statistic(
    setup: Setup, meter: GainMeter, effect: Effect, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return draws of T, (N_DRAWS,), summed over the nodes, and whether each selects the true scope."""
    total, scope_evidence = np.zeros(N_DRAWS), dict[str, Array]()
    for node in SIDES:
        clean, sigma = meter.clean_readings(node)
        interval = float(np.mean(np.diff(setup.sample_times[node])))
        ratios, scope_evidence[node] = _draw_node_statistic(
            effect, effect.applies_to(node), clean, sigma, interval, rng
        )
        total += ratios
    return total, _choose_scope(effect, scope_evidence)


def _choose_scope(effect: Effect, scope_evidence: Mapping[str, Array]) -> Array:
    """Return for each draw whether the true scope is more probable than all other scopes together.

    scope_evidence: for each node (N_DRAWS, K): ln likelihood ratio of the effect with each of K equally
        probable parameters against its absence on the node; the scope `all` has the same parameters on all
        nodes
    """
    scores = {node: logsumexp(ratio_per_hit, axis=1) for node, ratio_per_hit in scope_evidence.items()}
    scores["all"] = logsumexp(sum(scope_evidence.values()), axis=1)
    total_evidence = logsumexp(list(scores.values()), axis=0)
    # The tolerance covers rounding errors: a probability of exactly one half does not count.
    return np.asarray(scores[effect.scope] - total_evidence > np.log(0.5) + 1e-9)


def _draw_node_statistic(
    effect: Effect, is_present: bool, clean: Array, sigma: Array, interval: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return draws of T of a node, zeros without the effect, and the evidence for `_choose_scope`.

    clean, sigma: (n, 6) readings without noise, and their 1 sigma
    interval: time between samples, s
    """
    parameters = effect.parameters
    match effect.name:
        case "gyro_quantization":
            ratios = sum(
                _draw_widened_noise(parameters["step"], axis_sigma, rng) for axis_sigma in sigma[:, :3].T
            )
            return (
                (ratios, _certain_evidence(is_present))
                if is_present
                else (np.zeros(N_DRAWS), _certain_evidence(is_present))
            )
        case "gyro_rate_random_walk":
            ratios = sum(
                _draw_walk(parameters["k"], axis_sigma, interval, rng) for axis_sigma in sigma[:, :3].T
            )
            return (
                (ratios, _certain_evidence(is_present))
                if is_present
                else (np.zeros(N_DRAWS), _certain_evidence(is_present))
            )
        case "outliers":
            return _draw_mixture(parameters["probability"] * is_present, parameters["sigma"], clean.size, rng)
        case "sample_repeat":
            return _draw_stale(parameters["probability"] * is_present, clean, sigma, rng)
        case "gyro_saturation":
            return _draw_clipped(parameters["limit"], is_present, clean[:, :3], sigma[:, :3], GYRO_LSB, rng)
    return _draw_clipped(parameters["limit"], is_present, clean[:, 3:], sigma[:, 3:], ACCEL_LSB, rng)


def _certain_evidence(is_present: bool) -> Array:
    """Return the evidence (N_DRAWS, 1) of an effect whose presence or absence is certain."""
    return np.full((N_DRAWS, 1), 1e3 if is_present else -1e3)


def _draw_widened_noise(step: float, sigma: Array, rng: np.random.Generator) -> Array:
    """Return draws of T for noise widened by rounding; the lattice is not used, as every chip has one."""
    ratio = 1.0 + max(step**2 - GYRO_LSB**2, 0.0) / 12.0 / float(np.mean(sigma**2))
    squares = rng.chisquare(len(sigma), N_DRAWS)
    return 0.5 * ((ratio - 1.0) * squares - len(sigma) * np.log(ratio))


def _draw_walk(k: float, sigma: Array, interval: float, rng: np.random.Generator) -> Array:
    """Return draws of T for white noise with a random walk, by modes.

    The walk has the eigenvalues 1 / (4 sin²((2 j - 1) π / (4 n + 2))).
    """
    j, n = np.arange(1, _N_WAVES + 1), len(sigma)
    walk_eigenvalues = 1.0 / (4.0 * np.sin((2.0 * j - 1.0) * np.pi / (4.0 * n + 2.0)) ** 2)
    added_variance = k**2 * interval * walk_eigenvalues * np.mean(sigma**-2.0)
    squares = rng.standard_normal((N_DRAWS, _N_WAVES)) ** 2
    return 0.5 * (squares @ added_variance - np.sum(np.log1p(added_variance)))


def _draw_mixture(
    probability: float, size: float, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return draws of T for (1 - p) N(0, 1) + p N(0, 1 + size²) against N(0, 1), from binned counts."""
    edges = np.concatenate([np.linspace(0.0, 6.0, 121), np.linspace(6.2, 60.0, 120), [np.inf]])
    null_probability = -np.diff(norm.sf(edges))

    def wide_probability(size: float) -> Array:
        return np.asarray(-np.diff(norm.sf(edges / np.hypot(1.0, size))))

    def ratio(probability: float, wide_probability: Array) -> Array:
        # The null probability of the last bin underflows, but no reading falls there.
        return np.log1p(probability * (wide_probability / np.maximum(null_probability, 1e-290) - 1.0))

    mixture = 2.0 * ((1.0 - probability) * null_probability + probability * wide_probability(size))
    statistics = rng.multinomial(count, mixture / mixture.sum(), N_DRAWS)
    log_ratios = [
        ratio(axis_sigma, wide_probability(other)) for axis_sigma in _PROBABILITY_GRID for other in _SIZE_GRID
    ]
    return statistics @ ratio(probability, wide_probability(size)), statistics @ np.array(log_ratios).T


def _draw_stale(
    probability: float, clean: Array, sigma: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return draws of T for samples equal to their predecessor, against equality by chance."""
    change_in_sigma = np.diff(clean, axis=0) / sigma[1:]
    log_p_by_chance = np.sum(
        np.log(CHANNEL_LSB / (2.0 * np.sqrt(np.pi) * sigma[1:])) - 0.25 * change_in_sigma**2, 1
    )
    n_hits = (
        rng.binomial(len(log_p_by_chance), probability, N_DRAWS) if probability else np.zeros(N_DRAWS, int)
    )
    # A stale sample is recognised with near certainty, so the likelihood of a probability is binomial.
    n_missed = len(log_p_by_chance) - n_hits
    certain_gain = np.median(-log_p_by_chance) * n_hits
    scope_evidence = (
        certain_gain[:, None]
        + n_hits[:, None] * np.log(_PROBABILITY_GRID)
        + n_missed[:, None] * np.log1p(-_PROBABILITY_GRID)
    )
    if not probability:
        return np.zeros(N_DRAWS), scope_evidence
    ratio_per_hit = np.logaddexp(np.log(probability) - log_p_by_chance, np.log1p(-probability))
    ratios = n_missed * np.log1p(-probability)
    return ratios + np.array(
        [np.sum(rng.choice(ratio_per_hit, axis_sigma)) for axis_sigma in np.maximum(n_hits, 1)]
    ), scope_evidence


def _draw_clipped(
    limit: float, is_present: bool, clean: Array, sigma: Array, lsb: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return draws of T for clipped values: each has the probability of the whole tail beyond the limit.

    A reading beyond the limit proves that a node does not have the effect.
    """
    z = ((limit - np.abs(clean)) / sigma).ravel()
    exceeding = norm.logsf(z)
    is_close = exceeding > np.log(1e-7)
    z, exceeding, sigma = z[is_close], exceeding[is_close], sigma.ravel()[is_close]
    ratio_per_hit = np.maximum(exceeding - norm.logpdf(z) - np.log(lsb / sigma), 0.0)
    ratios, n_hits = np.zeros(N_DRAWS), np.zeros(N_DRAWS)
    for first in range(0, len(z), 500):
        chunk = slice(first, first + 500)
        is_hit = rng.random((N_DRAWS, len(z[chunk]))) < np.exp(exceeding[chunk])
        ratios, n_hits = ratios + is_hit @ ratio_per_hit[chunk], n_hits + np.count_nonzero(is_hit, axis=1)
    return (
        (ratios, ratios[:, None])
        if is_present
        else (np.zeros(N_DRAWS), np.where(n_hits > 0, -1e3, 0.0)[:, None])
    )
