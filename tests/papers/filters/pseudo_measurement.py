"""Gyro bias from the known magnitude of the true rate: the scalar filter of Shah et al., eq. 1-3.

With G = omega + b + e, e ~ N(0, S), the length of G - b is that of omega but for noise:
    z = |G|^2 - |omega|^2 - tr S = 2 G.b - |b|^2 + v,   v = 2 omega.e + |e|^2 - tr S,
    E v = 0,   var v = 4 omega' S omega + 2 tr S^2.
So h(b) = 2 G.b - |b|^2, H = dh/db = +2 (G - b)' (eq. 2), and eq. 3 puts G - b for omega in var v.

Eq. 3 fails near rest, in two ways. (G - b)' S (G - b) has the noise in it that it is the variance for, and
H has it too: H is correlated with v. And the quadratic is taken for a line: from a start wrong by d >> noise
every update halves the error but is believed in full. At rest the printed filter so ends far from the bias
and sure of it. Unless `as_printed`, this filter
- takes |omega|^2 as known in R and only its direction from the data, and puts E[|H|^2 v^2] / E[|H|^2] for the
  constant term: R = 4 |omega|^2 u' S u + 2 tr S^2 + 8 tr S^3 / tr S, u = (G - b) / |G - b|;
- takes the second order of h, which is exact as h'' = -2 I: innovation + tr P, its variance + 2 tr P^2.

What converges. One sample sees b along G - b only.
- at rest: all of b, from any start, each axis with 2/7 of the information of a mean (isotropic S), since the
  signs of the three components are thrown away. Where rest is known the mean is better by sqrt(7/2) = 1.9.
- omega turning through three directions in the node: all of b, if the start is wrong by less than about
  |omega| / 50. From further off it mostly arrives, but the covariance can be far too small.
- omega about one axis (a wheel): b along it. The other two stay at their start; what is wrong with them, d,
  appears along the axis as |d|^2 / (2 |omega|) and is not in the covariance (0.02 rad/s at 5 rad/s: 4e-5).
- |omega| held, one axis, start wrong by more than |omega| in its direction: the mirror solution
  b + 2 omega, with equal residuals. The other direction of turning, or another speed, takes it back, given
  some `walk`; without, the filter may already be too sure to move.
The covariance counts noise as white; a rate reference that is wrong for long (`rate_sigma` is white, too)
moves the bias by its error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY


@dataclass(frozen=True)
class BiasTrack:
    """After each sample: bias (N, 3) rad/s and the variances (N, 3) of its components."""

    bias: Array
    variance: Array


class PseudoMeasurementFilter:
    """The bias of three gyro axes, sample by sample.

    noise: (3, 3) covariance S of a gyro sample, (rad/s)^2. bias: (3,) rad/s at the start, sigma: (3,) or one,
    its 1 sigma. walk: rad/s, 1 sigma by which each bias walks between samples. as_printed: eq. 3 and a plain
    extended Kalman filter. ValueError where S or sigma is not positive.
    """

    __slots__ = (
        *("_begun", "_bias", "_constant", "_correlated", "_count", "_mean", "_noise", "_p", "_printed"),
        *("_rate", "_surprise", "_walk"),
    )

    def __init__(
        self,
        noise: ArrayLike,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        sigma: ArrayLike = 0.05,
        *,
        walk: float = 0.0,
        as_printed: bool = False,
    ) -> None:
        s = np.asarray(noise, dtype=np.float64)
        spread = np.broadcast_to(np.asarray(sigma, dtype=np.float64), 3)
        if (
            s.shape != (3, 3)
            or not np.allclose(s, s.T, rtol=1e-12, atol=0.0)
            or np.linalg.eigvalsh(s)[0] <= 0.0
        ):
            raise ValueError("noise must be a (3, 3) positive definite covariance in (rad/s)^2")
        if not (spread > 0.0).all():
            raise ValueError(f"sigma {spread}: must be above 0 rad/s")
        first, second, third = np.asarray(bias, dtype=np.float64).tolist()
        self._bias: tuple[float, float, float] = (first, second, third)
        self._p: tuple[float, ...] = (*(spread**2).tolist(), 0.0, 0.0, 0.0)
        self._begun, self._count, self._surprise, self._rate = spread**2, 0, 0.0, np.zeros(3)
        self._noise: tuple[float, ...] = tuple(s[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist())
        self._correlated = any(self._noise[3:])
        self._mean = float(np.trace(s))
        self._constant = 2.0 * float(np.trace(s @ s))
        if not as_printed:
            self._constant += 8.0 * float(np.trace(s @ s @ s)) / self._mean
        self._walk = walk * walk
        self._printed = as_printed

    @property
    def bias(self) -> tuple[float, float, float]:
        """rad/s. Across the axis of a wheel that only spins it is still the start: see the covariance."""
        return self._bias

    @property
    def covariance(self) -> Array:
        """(3, 3) of the bias, (rad/s)^2."""
        xx, yy, zz, xy, xz, yz = self._p
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def given_variance(self, scale_sigma: float) -> Array:
        """(3,) of the bias, with what the covariance does not count: vibration, scale, the other axes.

        Innovations beyond their variance widen it, up to what it began with. Two errors are constants in
        proportion to the mean rate, which no number of samples averages out: the gyro's scale, 1 sigma
        `scale_sigma`; and what the biases across it, of variance p, add to |G|, sum of p^2 / (2 |rate|^2).
        """
        variance = np.diag(self.covariance)
        if self._count and self._surprise > self._count:
            variance = np.minimum(variance * self._surprise / self._count, self._begun)
        square = float(self._rate @ self._rate)
        across = float(np.sum(np.diag(self.covariance) ** 2)) / (2.0 * square**2) if square else 0.0
        built: Array = variance + (scale_sigma**2 + across) * self._rate**2
        return built

    def update(
        self, gyro: Sequence[float], rate: float = 0.0, rate_sigma: float = 0.0
    ) -> tuple[float, float, float]:
        """Takes a sample, (3,) rad/s, and the true rate's magnitude with its 1 sigma; returns the bias."""
        bx, by, bz = self._bias
        xx, yy, zz, xy, xz, yz = self._p
        if self._walk:
            xx, yy, zz = xx + self._walk, yy + self._walk, zz + self._walk
        gx, gy, gz = gyro
        dx, dy, dz = gx - bx, gy - by, gz - bz
        ax, ay, az = dx * dx, dy * dy, dz * dz
        square = ax + ay + az
        # P H' / 2.
        hx = xx * dx + xy * dy + xz * dz
        hy = xy * dx + yy * dy + yz * dz
        hz = xz * dx + yz * dy + zz * dz
        known = rate * rate
        innovation = square - known - self._mean
        variance = 4.0 * (dx * hx + dy * hy + dz * hz) + self._constant
        if self._printed:
            weight = 4.0
        else:
            innovation += xx + yy + zz
            variance += 2.0 * (xx * xx + yy * yy + zz * zz) + 4.0 * (xy * xy + xz * xz + yz * yz)
            weight = 4.0 * known / square if known and square > 0.0 else 0.0
        if weight:
            sxx, syy, szz, sxy, sxz, syz = self._noise
            measured = sxx * ax + syy * ay + szz * az
            if self._correlated:
                measured += 2.0 * (sxy * dx * dy + sxz * dx * dz + syz * dy * dz)
            variance += weight * measured
        if rate_sigma:
            doubt = rate_sigma * rate_sigma
            innovation += doubt
            variance += doubt * (4.0 * known + 2.0 * doubt)
        step = 2.0 * innovation / variance
        self._surprise += innovation * innovation / variance
        self._count += 1
        self._rate += (np.asarray(gyro) - self._rate) / self._count
        self._bias = bias = (bx + step * hx, by + step * hy, bz + step * hz)
        shrink = 4.0 / variance
        gx, gy, gz = shrink * hx, shrink * hy, shrink * hz
        self._p = (xx - gx * hx, yy - gy * hy, zz - gz * hz, xy - gx * hy, xz - gx * hz, yz - gy * hz)
        return bias

    def run(self, gyro: Array, rate: ArrayLike = 0.0, rate_sigma: ArrayLike = 0.0) -> BiasTrack:
        """Takes (N, 3) samples and (N,) or one magnitude: N calls of `update`, bit for bit, and as slow.

        The filter is not linear and its gain is in the data: there is nothing to be done for all samples at
        once. ValueError for samples that are not (N, 3) and finite.
        """
        samples = np.asarray(gyro, dtype=np.float64)
        if samples.ndim != 2 or samples.shape[1] != 3 or not np.isfinite(samples).all():
            raise ValueError(f"samples of shape {samples.shape}: must be (N, 3) and finite")
        rates = np.broadcast_to(np.asarray(rate, dtype=np.float64), len(samples)).tolist()
        sigmas = np.broadcast_to(np.asarray(rate_sigma, dtype=np.float64), len(samples)).tolist()
        rows = (
            (*self.update(sample, magnitude, sigma), *self._p[:3])
            for sample, magnitude, sigma in zip(samples.tolist(), rates, sigmas, strict=True)
        )
        built: Array = np.fromiter(rows, np.dtype((np.float64, 6)), len(samples))
        return BiasTrack(built[:, :3], built[:, 3:])


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
