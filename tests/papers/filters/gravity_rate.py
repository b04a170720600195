"""Magnitude of a rolling wheel's rate from gravity, as the reference of the pseudo-measurement filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY


@dataclass(frozen=True)
class KnownRate:
    """Rate magnitudes of a rolling wheel in M segments, for `PseudoMeasurementFilter.run`.

    gyro: (M, 3) rad/s, weighted means. rate, sigma: (M,) rad/s, the mean magnitude with the same weights, and
    its 1 sigma. share: the covariance of such a mean is `share` times that of a sample.
    """

    gyro: Array
    rate: Array
    sigma: Array
    share: float


def rate_from_gravity(
    gyro: Array,
    accel: Array,
    dt: float,
    *,
    stretch: int,
    phase_sigma: float,
    radius: float = 0.0,
    arm: complex = 0j,
) -> KnownRate:
    """The wheel's own rate from gravity turning in (accel x, accel y), over stretches of `stretch` samples.

    gyro, accel: (N, 3) rad/s and m/s^2, node axes, z along the axle; dt: s; phase_sigma: rad, 1 sigma of the
    direction of one sample (vibration and accelerometer noise over g). radius: m, of the wheel; arm: m,
    x + iy of the lever arm.
    With phi the angle about z and w its rate, x + iy of the force is (the model's README, either facing)
        e^(-i phi) (g + i radius w') + (i w' - w^2) arm;
    arm and radius are taken out with w of the gyro, for which a bias is nothing. Left at zero they stay in
    the direction: radius w' / g for as long as the wheel accelerates, w^2 |arm| / g once per turn.
    The slope of a line fitted to the unwrapped direction is the mean of the true rate with parabolic weights,
    at any course of the speed; the gyro is averaged with the same. Across the axle the mean goes to zero with
    whole turns. A stretch that turns less than once is left out. ValueError: stretch < 8, fewer samples than
    that, or numbers of gyro and accel samples that differ.
    """
    if stretch < 8 or len(gyro) < stretch or len(gyro) != len(accel):
        raise ValueError(f"stretches of {stretch} samples in {len(gyro)} gyro and {len(accel)} accel samples")
    count = len(gyro) // stretch
    w = gyro[:, 2]
    change = np.gradient(w, dt)
    force = accel[:, 0] + 1j * accel[:, 1] - (1j * change - w * w) * arm
    force *= STANDARD_GRAVITY - 1j * radius * change
    force = force[: count * stretch].reshape(count, stretch)
    turns = np.angle(force[:, 1:] * force[:, :-1].conj())
    phase = np.concatenate([np.zeros((count, 1)), np.cumsum(turns, axis=1)], axis=1)
    line = np.arange(stretch) - 0.5 * (stretch - 1)
    line /= (line @ line) * dt
    slope = phase @ line
    # Sum of line_k phase_k = sum of weights_k (phase_k+1 - phase_k): summed by parts.
    weights = -np.cumsum(line)[:-1] * dt
    # A step of the phase is the mean of the rates at its two ends.
    at_samples = 0.5 * (np.append(weights, 0.0) + np.append(0.0, weights))
    means = np.einsum("msa,s->ma", gyro[: count * stretch].reshape(count, stretch, 3), at_samples)
    turned = np.abs(phase[:, -1]) > 2.0 * math.pi
    sigma = phase_sigma * float(np.sqrt(line @ line))
    rate = np.abs(slope[turned])
    return KnownRate(means[turned], rate, np.full(len(rate), sigma), float(at_samples @ at_samples))
