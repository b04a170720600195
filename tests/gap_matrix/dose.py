"""Strength of an effect in one drive: the expected gain in log-likelihood by knowing it, in nats.

The gain compares two filters with the true model, with and without the effect. Neither knows the wheel angle:
it is a random walk of unknown start that integrates the noise of the speed reference, so changes that equal a
shift or slow drift of the angle gain nothing. Random effects (quantisation, random walk, outliers, stale
samples, clipping) have the expectation of their own log-likelihood ratio.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from gap_matrix import cases, effects, sensor
from gap_matrix.cases import Setup
from gap_matrix.effects import Effect, scale_effect
from gap_matrix.sensor import ACCEL_LSB, GYRO_LSB
from gap_matrix.world import Array, IdealReadings

STRONG_NATS, MEDIUM_NATS, FAINT_NATS = 2000.0, 150.0, 12.0
STRENGTHS = {"strong": STRONG_NATS, "medium": MEDIUM_NATS, "faint": FAINT_NATS}
CHANNEL_LSB = np.repeat([GYRO_LSB, ACCEL_LSB], 3)
MECHANICAL_EFFECTS = {
    "wheel_radius", "tyre_growth", "wheel_slip", "wheel_eccentricity", "wheel_camber", "lever_arm",
    *effects.VEHICLE_EFFECTS,
}  # fmt: skip


@dataclass(frozen=True)
class _Node:
    """Readings of one node without the effect, their derivative and their noise."""

    ideal: IdealReadings
    clean: Array  # (n, 6) readings without noise
    angle_derivative: Array  # (n, 6) derivative of the readings by the wheel angle, per rad
    sigma: Array  # (n, 6) true 1 sigma
    angle_walk_variance: Array  # (n,) rad², variance of the walk of the wheel angle since the previous sample


class GainMeter:
    """A meter of the expected gains of effects in one setup.

    dead_sensor: `gyro`, `accel` or empty: a sensor whose channels carry no information
    """

    def __init__(self, setup: Setup, dead_sensor: str = "") -> None:
        self.setup = setup
        self._nodes = {node: self._build_node(node) for node in effects.SIDES}
        for node in self._nodes.values():
            node.sigma[:, {"gyro": slice(0, 3), "accel": slice(3, 6), "": slice(0)}[dead_sensor]] = np.inf

    def gain_of_difference(self, node: str, difference: Array) -> float:
        """Return the gain in nats of a known difference (n, 6) of the readings of a node."""
        node_data = self._nodes[node]
        return gain_with_free_angle(
            difference, node_data.angle_derivative, node_data.sigma, node_data.angle_walk_variance
        )

    def clean_readings(self, node: str) -> tuple[Array, Array]:
        """Return the readings (n, 6) of a node without effect and noise, and their 1 sigma (n, 6)."""
        return self._nodes[node].clean, self._nodes[node].sigma

    def reading_difference(self, node: str, effect: Effect) -> Array:
        """Return the change (n, 6) of the readings of a node by a deterministic effect."""
        node_data, sample_times, ideal = (
            self._nodes[node],
            self.setup.sample_times[node],
            self._nodes[node].ideal,
        )
        if effect.name in MECHANICAL_EFFECTS:
            ideal = cases.compute_node_readings(self.setup, node, [*self.setup.known, effect])
        # The model without the effect takes the time stamps as the sample times.
        stamps = sensor.compute_time_stamps(sample_times, effects.parameters_on_node([effect], node))
        expected = (
            node_data.clean
            if np.array_equal(stamps, sample_times)
            else self._compute_clean_readings(node, node_data.ideal, [], stamps)
        )
        return self._compute_clean_readings(node, ideal, [effect], sample_times) - expected

    def channel_energies(self, node: str, difference: Array) -> Array:
        """Return the sum of squares (6,) of a difference (n, 6) over each channel, in units of sigma²."""
        return np.sum((difference / self._nodes[node].sigma) ** 2, 0)

    def gain(self, effect: Effect) -> float:
        """Return the expected gain in nats, summed over the nodes that have the effect."""
        return sum(self._gain(node, effect) for node in effects.SIDES if effect.applies_to(node))

    def scale_to_gain(self, effect: Effect, target: float) -> tuple[Effect, float]:
        """Return the effect at the size that gains `target` nats within 2 %, and its gain.

        Stale samples and outliers occur in whole numbers, at least one. Raises ValueError if the drive shows
        too little of the effect at any possible size.
        """
        low, high, size = 0.0, np.inf, 1.0
        for _ in range(60):
            scaled_effect = scale_effect(effect, size)
            gain = self.gain(scaled_effect) if effects.is_possible(scaled_effect) else np.inf
            if abs(np.log(max(gain, 1e-12) / target)) < 0.02:
                break
            low, high = (size, high) if gain < target else (low, size)
            if high / max(low, 1e-9) < 1.0 + 1e-6:
                break
            size = _next_size(low, high, size, target / gain if gain else np.inf)
        if not np.isfinite(gain):
            scaled_effect = scale_effect(effect, low) if low else scaled_effect
            gain = self.gain(scaled_effect) if low else 0.0
        if gain < 0.5 * target:
            raise ValueError(
                f"{effect.name}: this drive shows {gain:.3g} of {target:g} nats at most; take another seed"
            )
        return self._round_to_whole_hits(scaled_effect), gain

    def _round_to_whole_hits(self, effect: Effect) -> Effect:
        """Return the effect with the probability of a whole number of outliers or stale samples."""
        if "probability" not in effect.parameters:
            return effect
        node = next(node for node in effects.SIDES if effect.applies_to(node))
        count = len(self.setup.sample_times[node]) * (6 if effect.name == "outliers" else 1)
        hits = sensor.count_hits(effect.parameters["probability"], count)
        return replace(effect, parameters={**effect.parameters, "probability": hits / count})

    def _build_node(self, node: str) -> _Node:
        setup, sample_times, step = self.setup, self.setup.sample_times[node], 1e-5
        ideal = cases.compute_node_readings(setup, node, setup.known)
        noise, motion = setup.noise[node], setup.drive.motion
        sigma = np.empty((len(sample_times), 6))
        speed = sensor.interpolate_cubic(motion.speed[None], motion.step, sample_times)[0]
        # Noise of the reference enters the predicted rate directly and the wheel angle as its integral.
        spin_noise = np.hypot(setup.speed_noise, 0.5 * setup.track * setup.yaw_rate_noise) / setup.radius
        sigma[:, :2] = np.hypot(noise.gyro, setup.yaw_rate_noise)
        sigma[:, 2] = np.hypot(noise.gyro, spin_noise)
        sigma[:, 3:] = sensor.compute_accel_sigma(noise, speed)[:, None]
        sigma = np.hypot(sigma, CHANNEL_LSB / np.sqrt(12.0))
        clean = self._compute_clean_readings(node, ideal, [], sample_times)
        readings_at_next_angle = self._compute_clean_readings(
            node,
            cases.compute_node_readings(setup, node, setup.known, angle_offset=step),
            [],
            sample_times,
        )
        angle_walk_variance = (
            spin_noise**2 * cases.REFERENCE_STEP * np.diff(sample_times, prepend=sample_times[0])
        )
        return _Node(ideal, clean, (readings_at_next_angle - clean) / step, sigma, angle_walk_variance)

    def _compute_clean_readings(self, node, ideal, hidden, sample_times):
        parameters = effects.parameters_on_node([*self.setup.known, *hidden], node)
        return sensor.compute_clean_readings(ideal, parameters, sample_times, self.setup.drive.temperature)

    def _gain(self, node: str, effect: Effect) -> float:
        node_data, setup, parameters = self._nodes[node], self.setup, effect.parameters
        match effect.name:
            case "gyro_quantization":
                return quantization_gain(parameters["step"], node_data.sigma[:, :3])
            case "gyro_rate_random_walk":
                interval = float(np.mean(np.diff(setup.sample_times[node])))
                return sum(random_walk_gain(parameters["k"], s, interval) for s in node_data.sigma[:, :3].T)
            case "outliers":
                return outlier_gain(parameters["probability"], parameters["sigma"], node_data.clean.size)
            case "sample_repeat":
                return repeat_gain(parameters["probability"], node_data.clean, node_data.sigma)
            case "gyro_saturation":
                return clipping_gain(
                    parameters["limit"], node_data.clean[:, :3], node_data.sigma[:, :3], GYRO_LSB
                )
            case "accel_saturation":
                return clipping_gain(
                    parameters["limit"], node_data.clean[:, 3:], node_data.sigma[:, 3:], ACCEL_LSB
                )
        return self.gain_of_difference(node, self.reading_difference(node, effect))


def _next_size(low: float, high: float, size: float, gain_ratio: float) -> float:
    """Return the size at which a quadratic gain is `gain_ratio` times larger, if it is inside (low, high).

    Otherwise the geometric mean of the bounds, or a step outwards as long as a bound is unknown.
    """
    guess = size * np.sqrt(gain_ratio)
    if low * 1.01 < guess < high * 0.99:
        return guess
    if low > 0.0 and high < np.inf:
        return float(np.sqrt(low * high))
    return size * (1.5 if high == np.inf else 0.3)


def gain_with_free_angle(
    difference: Array, angle_derivative: Array, sigma: Array, angle_walk_variance: Array
) -> float:
    """Return ½ d' (R + H P H')⁻¹ d for a difference d, (n, 6), of the readings.

    R = diag(sigma²) is the noise. H = `angle_derivative`, (n, 6), is the derivative by the wheel angle, which
    is unknown at first (P) and then a random walk with the step variances `angle_walk_variance`, (n,). The
    result is half the sum of squared normalised innovations of a Kalman filter of the angle whose measurement
    is d.
    """
    square_sums = np.sum((difference / sigma) ** 2, 1).tolist()
    angle_scores = np.sum(angle_derivative * difference / sigma**2, 1).tolist()
    weight = np.sum((angle_derivative / sigma) ** 2, 1).tolist()
    angle, variance, total = 0.0, 1e4, 0.0
    for c, b, a, q in zip(square_sums, angle_scores, weight, angle_walk_variance.tolist(), strict=True):
        variance += q
        updated_variance = variance / (1.0 + variance * a)
        innovation = b - angle * a
        total += c - 2.0 * angle * b + angle * angle * a - innovation * innovation * updated_variance
        angle += innovation * updated_variance
        variance = updated_variance
    return 0.5 * total


def quantization_gain(step: float, sigma: Array) -> float:
    """Return the gain of noise variance sigma² + (step² - LSB²) / 12 over sigma².

    The lattice of the values itself, which would gain far more, is not counted.
    """
    ratio = 1.0 + max(step**2 - GYRO_LSB**2, 0.0) / 12.0 / sigma**2
    return float(0.5 * np.sum(ratio - 1.0 - np.log(ratio)))


def random_walk_gain(k: float, sigma: Array, interval: float) -> float:
    """Return the gain of white noise plus a random walk, k √interval per sample, over white noise alone.

    The covariance of the walk, min(i, j), has the eigenvalues 1 / (4 sin²((2 j - 1) π / (4 n + 2))).
    """
    n = len(sigma)
    walk_eigenvalues = 1.0 / (4.0 * np.sin((2.0 * np.arange(1, n + 1) - 1.0) * np.pi / (4.0 * n + 2.0)) ** 2)
    ratio = k**2 * interval * walk_eigenvalues * np.mean(sigma**-2.0)
    return float(0.5 * np.sum(ratio - np.log1p(ratio)))


def outlier_gain(probability: float, size: float, count: int) -> float:
    """Return the gain of the mixture (1 - p) N(0, 1) + p N(0, 1 + size²) over N(0, 1), by quadrature."""
    hits = sensor.count_hits(probability, count) / count
    mixture_sigma = np.hypot(1.0, size)
    x = np.linspace(0.0, 9.0 * mixture_sigma, 6001)
    log_ratio = np.logaddexp(
        np.log1p(-hits), np.log(hits) + norm.logpdf(x, scale=mixture_sigma) - norm.logpdf(x)
    )
    density = np.exp(log_ratio + norm.logpdf(x))
    return float(2.0 * count * np.trapezoid(density * log_ratio, x))


def repeat_gain(probability: float, clean: Array, sigma: Array) -> float:
    """Return the gain of samples that equal their predecessor in all six rounded channels.

    A stale sample is equal with certainty; the probability of equality by chance decreases with finer
    rounding and with the change of the true readings.
    """
    hits = sensor.count_hits(probability, len(clean)) / len(clean)
    change_in_sigma = np.diff(clean, axis=0) / sigma[1:]
    nats_per_sample = np.sum(
        np.log(sigma[1:] * np.sqrt(2.0 * np.pi) / CHANNEL_LSB) + 0.5 + 0.5 * change_in_sigma**2, 1
    )
    return float(
        len(clean) * (hits * (np.mean(nats_per_sample) + np.log(hits)) + (1.0 - hits) * np.log1p(-hits))
    )


def clipping_gain(limit: float, clean: Array, sigma: Array, lsb: float) -> float:
    """Return the gain of clipped values: each has the probability of the whole tail beyond the limit."""
    z = (limit - np.abs(clean)) / sigma
    log_tail = norm.logsf(z)
    nats_per_sample = np.exp(log_tail) * (log_tail - norm.logpdf(z) - np.log(lsb / sigma))
    return float(np.sum(np.maximum(nats_per_sample, 0.0)))
