"""Gyro bias from the known magnitude of the angular rate: the scalar filter of Shah et al., eq. 1-3.

With the sample G = omega + b + e, e ~ N(0, S), the length of G - b is that of omega except for noise:
    z = |G|^2 - |omega|^2 - tr S = 2 G.b - |b|^2 + v,   v = 2 omega.e + |e|^2 - tr S,
    E v = 0,   var v = 4 omega' S omega + 2 tr S^2.
So h(b) = 2 G.b - |b|^2 and H = dh/db = +2 (G - b)' (eq. 2); eq. 3 uses G - b in place of omega in var v.

Eq. 3 fails near standstill for two reasons. (G - b)' S (G - b) contains the noise whose variance it is to
give, as does H, so that H is correlated with v. And the quadratic is linearised: with an initial error d much
larger than the noise every update halves the error, while the covariance assumes that it is gone. At
standstill the printed filter therefore ends far from the bias with a small sigma. Unless `as_printed`, this
filter
- takes |omega|^2 in R as known and only its direction from the data, and uses E[|H|^2 v^2] / E[|H|^2] for the
  constant term: R = 4 |omega|^2 u' S u + 2 tr S^2 + 8 tr S^3 / tr S, u = (G - b) / |G - b|;
- includes the second order of h, which is exact because h'' = -2 I: innovation + tr P, variance + 2 tr P^2.

Observability: one sample determines b along G - b only.
- Standstill: all of b, from any initial value, each axis with 2/7 of the information of a mean (isotropic
  S), because the signs of the three components are not used. The mean is better by sqrt(7/2) = 1.9.
- omega in three directions of the node: all of b, if the initial error is below about |omega| / 50. From
  further off the filter usually converges, but its covariance can be far too small.
- omega about one axis (a wheel): b along it. The other two components stay at their initial value; their
  error d adds |d|^2 / (2 |omega|) along the axis, which the covariance omits (0.02 rad/s at 5 rad/s: 4e-5).
- Constant |omega| about one axis, with an initial error beyond |omega| in its direction: the filter converges
  to the mirror solution b + 2 omega, which has equal residuals. Rotation in the other direction or at
  another speed resolves it if `walk` is above zero.
The covariance assumes white noise; a reference rate with a lasting error moves the bias by that error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hubodo.arrays import Array


@dataclass(frozen=True)
class BiasTrack:
    """The bias after each sample, (N, 3) rad/s, and the variances of its components, (N, 3)."""

    bias: Array
    variance: Array


class PseudoMeasurementFilter:
    """A filter of the bias of three gyro axes, sample by sample.

    noise: (3, 3) covariance S of a gyro sample, (rad/s)^2. bias: (3,) initial value, rad/s. sigma: (3,) or
    one, its 1 sigma. walk: standard deviation of the random walk of each bias per sample, rad/s. as_printed:
    use eq. 3 and a plain extended Kalman filter. Raises ValueError unless S and sigma are positive.
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
        """Return the bias, rad/s; components across the axle of a wheel keep their initial value."""
        return self._bias

    @property
    def covariance(self) -> Array:
        """Return the (3, 3) covariance of the bias, (rad/s)^2."""
        xx, yy, zz, xy, xz, yz = self._p
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def given_variance(self, scale_sigma: float) -> Array:
        """Return the (3,) variance of the bias including vibration, scale error and the other axes.

        Innovations beyond their variance inflate it, up to the initial variance. Two errors are proportional
        to the mean rate and do not average out: the gyro's scale error, 1 sigma `scale_sigma`; and the
        contribution of the biases across the axle, of variance p, to |G|: sum of p^2 / (2 |rate|^2).
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
        """Process a sample (3,) with the magnitude of the true rate and its sigma; return the bias."""
        bx, by, bz = self._bias
        xx, yy, zz, xy, xz, yz = self._p
        if self._walk:
            xx, yy, zz = xx + self._walk, yy + self._walk, zz + self._walk
        gx, gy, gz = gyro
        dx, dy, dz = gx - bx, gy - by, gz - bz
        ax, ay, az = dx * dx, dy * dy, dz * dz
        square = ax + ay + az
        # Half of P H'.
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
        """Process (N, 3) samples with their magnitudes, (N,) or scalar; bit-identical to N calls of `update`.

        The gain depends on the data, so the recursion cannot be vectorised. Raises ValueError for samples
        that are not (N, 3) and finite.
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
