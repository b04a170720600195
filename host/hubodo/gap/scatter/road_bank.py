"""Bank of the road: likelihood of the force to the left that both wheels have in common."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION
from hubodo.gap.process_noise.window_sums import winsorise
from hubodo.gap.scatter.base import Proposal, parameter_cost
from hubodo.gap.state.terms import VEHICLE, ModelTerm
from hubodo.vehicle import facing_sign

EFFECT_NAME = "road_bank"
# Grids of sigma, rad, from 0.02° to 8°, and of the length, m, from a ramp to a hill.
_SIGMAS, _LENGTHS = np.geomspace(3e-4, 0.15, 19), np.geomspace(5.0, 500.0, 9)
# Gain of ln likelihood; less is not worth a refit.
_MIN_BANK_GAIN = 10.0
# Evidence deducted because a process can imitate any slow drift.
_DRIFT_PENALTY = 2.0


def detect_road_bank(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect a bank by maximum likelihood of sigma and length, from the mean over all nodes on wheels."""
    wheels = [one for one in residuals if one.node.on_wheel and one.node.used[5]]
    if not wheels or BY_NAME[EFFECT_NAME] in wheels[0].effects:
        return []
    bank, variance = _measure_bank(wheels)
    distances = _measure_distances(wheels, len(bank))
    grid = np.array([(sigma, length) for sigma in _SIGMAS for length in _LENGTHS])
    likelihoods = _log_likelihoods(bank, variance, distances, np.vstack([[0.0, _LENGTHS[0]], grid]))
    gains = (likelihoods[1:] - likelihoods[0]).reshape(len(_SIGMAS), len(_LENGTHS))
    best_sigma, best_length = np.unravel_index(int(np.argmax(gains)), gains.shape)
    gain = float(gains[best_sigma, best_length])
    if gain < _MIN_BANK_GAIN:
        return []
    sigma, length = float(_SIGMAS[best_sigma]), float(_LENGTHS[best_length])
    # The process crosses its mean about this often; each crossing is one independent observation of its size.
    n_independent = max(float(distances.sum()) / (2.0 * length), 1.0)
    sigmas = {"sigma": sigma / math.sqrt(2.0 * n_independent), "length": length / math.sqrt(n_independent)}
    largest = int(np.argmax(np.abs(bank) * (variance < np.median(variance) * 4.0)))
    where = (
        f"the force to the left that the wheels have in common: {math.degrees(sigma):.2g}° rms, "
        f"{math.degrees(bank[largest]):+.2g}° at {WINDOW_DURATION * (largest + 0.5):.0f} s"
    )
    cost = 2.0 * parameter_cost(len(bank)) + _DRIFT_PENALTY
    effect = BY_NAME[EFFECT_NAME](sigma=sigma, length=length)  # type: ignore[call-arg]
    return [Proposal(ModelTerm(effect, VEHICLE), gain, gain - cost, sigmas, where)]


def _measure_bank(wheels: Sequence[Residual]) -> tuple[Array, Array]:
    """Return the bank in each window, (K,) rad, and its variance, as the mean of the wheels."""
    first = _first_time(wheels)
    count = 1 + max(int((one.node.t[-1] - first) / WINDOW_DURATION) for one in wheels)
    total, information = np.zeros(count), np.full(count, 1e-9)
    for one in wheels:
        window = ((one.node.t - first) / WINDOW_DURATION).astype(np.intp)
        sigma = one.noise.channel_sigma(5)
        value = winsorise(one.value[[5]] / sigma)[0] * sigma
        weight = (one.noise.is_new & ~one.node.is_saturated[5]) / sigma**2
        sign = facing_sign(one.node.mount.facing or "left")
        total += np.bincount(window, weight * sign * value, count) * STANDARD_GRAVITY
        information += np.bincount(window, weight, count) * STANDARD_GRAVITY**2
    return total / information, 1.0 / information


def _measure_distances(wheels: Sequence[Residual], count: int) -> Array:
    """Return the distance driven in each window, (count,) m: at standstill the bank stays as it is."""
    centres = _first_time(wheels) + WINDOW_DURATION * (np.arange(count) + 0.5)
    last = max(float(one.node.t[-1]) for one in wheels)
    speed = wheels[0].node.forward.inputs.at(np.minimum(centres, last)).speed
    return np.asarray(np.abs(speed) * WINDOW_DURATION)


def _first_time(wheels: Sequence[Residual]) -> float:
    return min(float(one.node.t[0]) for one in wheels)


def _log_likelihoods(bank: Array, variance: Array, distances: Array, grid: Array) -> Array:
    """Return ln likelihood, (G,), of Gauss-Markov processes in white noise, by Kalman filters.

    distances: (K,) m, driven in each window
    grid: (G, 2), 1 sigma and correlation length
    """
    sigma, length = grid.T
    decays = np.exp(-distances[:, None] / length)
    mean, spread = np.zeros(len(grid)), sigma**2
    total = np.zeros(len(grid))
    for value, noise, decay in zip(bank.tolist(), variance.tolist(), decays, strict=True):
        covariance = spread + noise
        innovation = value - mean
        total -= 0.5 * (innovation**2 / covariance + np.log(covariance))
        gain = spread / covariance
        mean = decay * (mean + gain * innovation)
        spread = decay**2 * (1.0 - gain) * spread + sigma**2 * (1.0 - decay**2)
    return total
