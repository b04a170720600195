"""Strength of an effect on one drive: the log-likelihood gained by knowing it, in nats.

The gain is what a filter gains that knows everything, the effect included, over one that knows everything but
the effect. Neither is given the wheel's angle: it starts anywhere and walks as the speed reference's noise
lets it, so what a shift or a slow drift of the angle can imitate does not count. Effects that are chance
(quantisation, random walk, outliers, stale samples, clipping) have the expectation of their own likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from gap_matrix import cases, effects, sensor
from gap_matrix.cases import Setup
from gap_matrix.effects import Effect, scaled
from gap_matrix.sensor import ACCEL_LSB, GYRO_LSB
from gap_matrix.world import Array, Channels

STRONG, MEDIUM, FAINT = 2000.0, 150.0, 12.0
STRENGTHS = {"strong": STRONG, "medium": MEDIUM, "faint": FAINT}
LSB = np.repeat([GYRO_LSB, ACCEL_LSB], 3)
IN_THE_WORLD = {
    "wheel_radius", "tyre_growth", "wheel_slip", "wheel_eccentricity", "wheel_camber", "lever_arm",
    *effects.VEHICLE,
}  # fmt: skip


@dataclass(frozen=True)
class _Node:
    """One node without the effect: ideal readings, derivative by wheel angle, and noise, (n, 6) each."""

    felt: Channels
    clean: Array
    turning: Array
    sigma: Array
    drift: Array  # (n,) rad², variance of the angle's walk since the sample before


class Meter:
    """A meter of effects on one setup, which stores what does not depend on the effect.

    dead: `gyro` or `accel`, whose channels say nothing.
    """

    def __init__(self, setup: Setup, dead: str = "") -> None:
        self.setup = setup
        self._nodes = {node: self._node(node) for node in effects.SIDES}
        for node in self._nodes.values():
            node.sigma[:, {"gyro": slice(0, 3), "accel": slice(3, 6), "": slice(0)}[dead]] = np.inf

    def gain_of(self, node: str, difference: Array) -> float:
        """Nats that a known difference (n, 6) of a node's channels gains."""
        base = self._nodes[node]
        return angle_free_gain(difference, base.turning, base.sigma, base.drift)

    def readings(self, node: str) -> tuple[Array, Array]:
        """(n, 6) each: what the channels of a node read without the effect and without noise, and 1 sigma."""
        return self._nodes[node].clean, self._nodes[node].sigma

    def difference(self, node: str, effect: Effect) -> Array:
        """(n, 6): what an effect that is not chance changes in the channels of a node that it concerns."""
        base, taken, felt = self._nodes[node], self.setup.taken[node], self._nodes[node].felt
        if effect.name in IN_THE_WORLD:
            felt = cases.channels(self.setup, node, [*self.setup.known, effect])
        # The model without the effect believes the stamps.
        believed = sensor.stamps(taken, effects.settings([effect], node))
        expected = (
            base.clean if np.array_equal(believed, taken) else self._clean(node, base.felt, [], believed)
        )
        return self._clean(node, felt, [effect], taken) - expected

    def energy(self, node: str, difference: Array) -> Array:
        """(6,): squares of a difference (n, 6) in sigmas, summed over each channel."""
        return np.sum((difference / self._nodes[node].sigma) ** 2, 0)

    def gain(self, effect: Effect) -> float:
        """Expected gain in nats over the nodes that the effect concerns."""
        return sum(self._gain(node, effect) for node in effects.SIDES if effect.concerns(node))

    def dose(self, effect: Effect, target: float) -> tuple[Effect, float]:
        """The effect at the size that gains `target` nats within 2 %, and what it gains.

        Stale samples and outliers come in whole numbers and cannot get below one. ValueError when the drive
        shows too little of the effect at any possible size.
        """
        low, high, size = 0.0, np.inf, 1.0
        for _ in range(60):
            made = scaled(effect, size)
            reached = self.gain(made) if effects.possible(made) else np.inf
            if abs(np.log(max(reached, 1e-12) / target)) < 0.02:
                break
            low, high = (size, high) if reached < target else (low, size)
            if high / max(low, 1e-9) < 1.0 + 1e-6:
                break
            size = _next_size(low, high, size, target / reached if reached else np.inf)
        if not np.isfinite(reached):
            made = scaled(effect, low) if low else made
            reached = self.gain(made) if low else 0.0
        if reached < 0.5 * target:
            raise ValueError(
                f"{effect.name}: this drive shows {reached:.3g} of {target:g} nats at most; take another seed"
            )
        return self._counted(made), reached

    def _counted(self, effect: Effect) -> Effect:
        """With the probability that the whole number of hits amounts to."""
        if "probability" not in effect.parameters:
            return effect
        node = next(node for node in effects.SIDES if effect.concerns(node))
        count = len(self.setup.taken[node]) * (6 if effect.name == "outliers" else 1)
        hits = sensor.chosen(effect.parameters["probability"], count)
        return replace(effect, parameters={**effect.parameters, "probability": hits / count})

    def _node(self, node: str) -> _Node:
        setup, taken, step = self.setup, self.setup.taken[node], 1e-5
        felt = cases.channels(setup, node, setup.known)
        noise, motion = setup.noise[node], setup.drive.motion
        sigma = np.empty((len(taken), 6))
        speed = sensor.sampled(motion.speed[None], motion.step, taken)[0]
        # The reference's own noise: at once in the rate it predicts, summed up in the angle.
        spin_noise = np.hypot(setup.speed_noise, 0.5 * setup.track * setup.yaw_rate_noise) / setup.radius
        sigma[:, :2] = np.hypot(noise.gyro, setup.yaw_rate_noise)
        sigma[:, 2] = np.hypot(noise.gyro, spin_noise)
        sigma[:, 3:] = sensor.accel_sigma(noise, speed)[:, None]
        sigma = np.hypot(sigma, LSB / np.sqrt(12.0))
        clean = self._clean(node, felt, [], taken)
        turned = self._clean(node, cases.channels(setup, node, setup.known, turned=step), [], taken)
        drift = spin_noise**2 * cases.REFERENCE_STEP * np.diff(taken, prepend=taken[0])
        return _Node(felt, clean, (turned - clean) / step, sigma, drift)

    def _clean(self, node, felt, hidden, at):
        found = effects.settings([*self.setup.known, *hidden], node)
        return sensor.clean(felt, found, at, self.setup.drive.temperature)

    def _gain(self, node: str, effect: Effect) -> float:
        base, setup, parameters = self._nodes[node], self.setup, effect.parameters
        match effect.name:
            case "gyro_quantization":
                return quantization_gain(parameters["step"], base.sigma[:, :3])
            case "gyro_rate_random_walk":
                interval = float(np.mean(np.diff(setup.taken[node])))
                return sum(random_walk_gain(parameters["k"], s, interval) for s in base.sigma[:, :3].T)
            case "outliers":
                return outlier_gain(parameters["probability"], parameters["sigma"], base.clean.size)
            case "sample_repeat":
                return repeat_gain(parameters["probability"], base.clean, base.sigma)
            case "gyro_saturation":
                return clipping_gain(parameters["limit"], base.clean[:, :3], base.sigma[:, :3], GYRO_LSB)
            case "accel_saturation":
                return clipping_gain(parameters["limit"], base.clean[:, 3:], base.sigma[:, 3:], ACCEL_LSB)
        return self.gain_of(node, self.difference(node, effect))


def _next_size(low: float, high: float, size: float, wanted: float) -> float:
    """Return the size at which a quadratic gain is `wanted` times larger, if inside (low, high).

    Else half way between the bounds; else outwards, while one is not known yet.
    """
    guess = size * np.sqrt(wanted)
    if low * 1.01 < guess < high * 0.99:
        return guess
    if low > 0.0 and high < np.inf:
        return float(np.sqrt(low * high))
    return size * (1.5 if high == np.inf else 0.3)


def angle_free_gain(difference: Array, turning: Array, sigma: Array, drift: Array) -> float:
    """Return ½ d' (R + H P H')⁻¹ d for a difference d, (n, 6), of the channels.

    Noise R = diag(sigma²); an angle that enters by H = `turning`, unknown at first, then walking with the
    variances `drift` (n,). It is the quadratic form of a Kalman filter's innovations when d is what it sees.
    """
    own = np.sum((difference / sigma) ** 2, 1).tolist()
    seen = np.sum(turning * difference / sigma**2, 1).tolist()
    weight = np.sum((turning / sigma) ** 2, 1).tolist()
    angle, variance, total = 0.0, 1e4, 0.0
    for c, b, a, q in zip(own, seen, weight, drift.tolist(), strict=True):
        variance += q
        shrink = variance / (1.0 + variance * a)
        pull = b - angle * a
        total += c - 2.0 * angle * b + angle * angle * a - pull * pull * shrink
        angle += pull * shrink
        variance = shrink
    return 0.5 * total


def quantization_gain(step: float, sigma: Array) -> float:
    """Return the gain of noise variance sigma² + (step² - LSB²) / 12 over sigma².

    That the values lie on a coarse lattice shows far more, to whoever looks at values instead.
    """
    ratio = 1.0 + max(step**2 - GYRO_LSB**2, 0.0) / 12.0 / sigma**2
    return float(0.5 * np.sum(ratio - 1.0 - np.log(ratio)))


def random_walk_gain(k: float, sigma: Array, interval: float) -> float:
    """Return the gain of white noise plus a walk, k √interval per sample, over white noise alone.

    The walk's covariance min(i, j) has the eigenvalues 1 / (4 sin²((2 j - 1) π / (4 n + 2))).
    """
    n = len(sigma)
    spread = 1.0 / (4.0 * np.sin((2.0 * np.arange(1, n + 1) - 1.0) * np.pi / (4.0 * n + 2.0)) ** 2)
    ratio = k**2 * interval * spread * np.mean(sigma**-2.0)
    return float(0.5 * np.sum(ratio - np.log1p(ratio)))


def outlier_gain(probability: float, size: float, count: int) -> float:
    """Return the gain of the mixture (1 - p) N(0, 1) + p N(0, 1 + size²) over N(0, 1), by quadrature."""
    hits = sensor.chosen(probability, count) / count
    wide = np.hypot(1.0, size)
    x = np.linspace(0.0, 9.0 * wide, 6001)
    log_ratio = np.logaddexp(np.log1p(-hits), np.log(hits) + norm.logpdf(x, scale=wide) - norm.logpdf(x))
    density = np.exp(log_ratio + norm.logpdf(x))
    return float(2.0 * count * np.trapezoid(density * log_ratio, x))


def repeat_gain(probability: float, clean: Array, sigma: Array) -> float:
    """Return the gain of samples that equal their predecessor in six rounded channels.

    That is certain where a sample is stale, and else the less likely the narrower the roundings are and the
    further the channels have moved on.
    """
    hits = sensor.chosen(probability, len(clean)) / len(clean)
    moved = np.diff(clean, axis=0) / sigma[1:]
    each = np.sum(np.log(sigma[1:] * np.sqrt(2.0 * np.pi) / LSB) + 0.5 + 0.5 * moved**2, 1)
    return float(len(clean) * (hits * (np.mean(each) + np.log(hits)) + (1.0 - hits) * np.log1p(-hits)))


def clipping_gain(limit: float, clean: Array, sigma: Array, lsb: float) -> float:
    """Return the gain of clipped values, which stand for the whole tail beyond the limit."""
    z = (limit - np.abs(clean)) / sigma
    beyond = norm.logsf(z)
    each = np.exp(beyond) * (beyond - norm.logpdf(z) - np.log(lsb / sigma))
    return float(np.sum(np.maximum(each, 0.0)))
