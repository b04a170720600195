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

    gyro: (M, 3) weighted means, rad/s. rate, sigma: (M,) mean magnitude with the same weights and its 1
    sigma, rad/s. share: covariance of such a mean as a fraction of that of a sample.
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
    """Return the rate of a wheel from the rotation of gravity, in segments of `stretch` samples.

    gyro, accel: (N, 3) rad/s and m/s², node axes, z along the axle; dt: s; phase_sigma: 1 sigma of the
    direction of one sample, rad (vibration and accelerometer noise over g). radius: radius of the wheel, m;
    arm: lever arm x + iy, m.

    With phi the angle about z and w its rate, x + iy of the force is (the model's README, either facing)
    e^(-i phi) (g + i radius w') + (i w' - w^2) arm; arm and radius are corrected with w of the gyro, whose
    bias is negligible here. With arm and radius of zero the direction has errors of radius w' / g while the
    wheel accelerates, and of w^2 |arm| / g once per turn.

    The slope of a line fitted to the unwrapped direction is the mean of the true rate with parabolic weights
    for any course of the speed; the gyro is averaged with the same weights. Across the axle the mean vanishes
    over whole turns. A segment of less than one turn is omitted. Raises ValueError for stretch < 8, too few
    samples, or different numbers of gyro and accel samples.
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
    # Summation by parts: sum of line_k phase_k = sum of weights_k (phase_k+1 - phase_k).
    weights = -np.cumsum(line)[:-1] * dt
    # A phase step is the mean of the rates at its two ends.
    at_samples = 0.5 * (np.append(weights, 0.0) + np.append(0.0, weights))
    means = np.einsum("msa,s->ma", gyro[: count * stretch].reshape(count, stretch, 3), at_samples)
    turned = np.abs(phase[:, -1]) > 2.0 * math.pi
    sigma = phase_sigma * float(np.sqrt(line @ line))
    rate = np.abs(slope[turned])
    return KnownRate(means[turned], rate, np.full(len(rate), sigma), float(at_samples @ at_samples))
