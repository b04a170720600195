"""Likelihood of an Allan deviation given its noise terms, and its maximisation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.sensors.allan.covariance import covariance_tensor, design_matrix
from hubodo.sensors.allan.deviation import AllanPoints
from hubodo.sensors.allan.gauss_newton import minimise

Q, N, B, K, R, BAND = range(6)
"""Indices of the terms in the parameter vector x, (6,): logarithms of the squares of Q, N, B, K.

R; ln(1 + band).
"""

ABSENT_LOG_SQUARE = -80.0
_ALIASED_FLICKER_SHARE = 0.11
# Relative accuracy of the sums over lags in the covariance; added to the diagonal of the correlation matrix.
_CORRELATION_RIDGE = 1e-3
_MAX_LOG_RANGE, _START_LOG_RANGE = 12.0, 4.0


@dataclass(frozen=True)
class NoiseParameters:
    """The noise parameters at one point, or at M points, of the parameter space.

    Attributes:
        theta: (5,) or (M, 5) squares of Q, N, B, K, R.
        ramp: R with its sign.
        band: relative change of the white noise variance at the first averaging time used; negative behind
            a low-pass.
    """

    theta: Array
    ramp: Array
    band: Array

    @classmethod
    def from_vector(cls, x: Array) -> NoiseParameters:
        """Return the parameters of a vector x, (6,) or (M, 6)."""
        theta = np.where(x[..., :5] <= ABSENT_LOG_SQUARE, 0.0, np.exp(x[..., :5]))
        theta[..., R] = x[..., R] ** 2
        return cls(theta, x[..., R], np.expm1(x[..., BAND]))


@dataclass(frozen=True)
class LikelihoodMaximum:
    """The maximum of the likelihood: parameter vector x, indices of active terms, cost = -2 ln likelihood."""

    x: Array
    active: tuple[int, ...]
    cost: float


@dataclass
class Likelihood:
    """The likelihood of the noise terms, given an Allan variance at octaves and the slope of the record.

    An overlapping Allan variance is approximately a multiple of chi-square whose degrees of freedom follow
    from its mean and variance; its cube root is approximately Gaussian (Wilson and Hilferty 1931). The
    correlation of the points is that of `covariance_tensor`. The slope is Gaussian with the variance that
    the terms imply.

    Attributes:
        factors, tau, avar: (P,) averaging factors, averaging times (s) and Allan variances.
        tensor: (P, P, 5, 5) of `covariance_tensor`.
        slope: least-squares slope of the record, unit/s.
        duration: length of the record, s.
        misfit: relative error of the model, independent from point to point.
        detrended: the points are those of the record minus its slope, so that only the slope informs the
            ramp.
        correlated: Allan variances of correlated noise beside the terms, see `markov`, (P,) or one row for
            each of M points of `residuals`; None for none.
    """

    factors: NDArray[np.int64]
    tau: Array
    avar: Array
    tensor: Array
    slope: float
    duration: float
    misfit: float = 0.0
    detrended: bool = False
    correlated: Array | None = None
    _flat_tensor: Array = field(init=False, repr=False)
    _design: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._design = design_matrix(self.tau)
        if self.detrended:
            self._design[:, R] = 0.0
        # The record does not tell whether samples are instantaneous or averages over the sample interval.
        # At factor m the two differ by 1 / (2 m^2) of the variance of a random walk. For flicker noise
        # they differ by the power above the sampling rate, which is aliased or removed: about a tenth of
        # B^2 / m, which resembles white noise, and as much again with the shape of quantisation. This
        # error is fully correlated between factors.
        m = self.factors.astype(float)
        walk = 0.5 / m**2 * self._design[:, K]
        folded = np.outer(1.0 / m, 1.0 / m) + np.outer(m**-2, m**-2)
        tensor = self.tensor.copy()
        tensor[:, :, B, B] += _ALIASED_FLICKER_SHARE**2 * folded
        tensor[:, :, K, K] += np.outer(walk, walk)
        self._flat_tensor = tensor.reshape(len(self.tau) ** 2, 25).T.copy()

    @classmethod
    def from_points(
        cls, points: AllanPoints, used: NDArray[np.bool_], slope: float, *, detrended: bool = False
    ) -> Likelihood:
        """Return the likelihood of the points selected by `used`, (P,)."""
        factors, tau = points.factors[used], points.tau[used]
        tensor = covariance_tensor(factors, points.samples, points.dt)
        # With gaps there are fewer pairs than in a complete record, so the covariance is larger by that
        # ratio.
        pair_ratio = (points.samples - 2 * factors + 1) / points.pairs[used]
        tensor *= np.sqrt(np.outer(pair_ratio, pair_ratio))[:, :, None, None]
        duration = points.samples * points.dt
        if detrended:
            tensor[:, :, R, :] = tensor[:, :, :, R] = 0.0
        return cls(factors, tau, points.adev[used] ** 2, tensor, slope, duration, detrended=detrended)

    def from_octave(self, start: int) -> Likelihood:
        """Return the likelihood of the points from octave `start` on."""
        part = slice(start, None)
        tensor = self.tensor[part, part]
        return Likelihood(
            self.factors[part],
            self.tau[part],
            self.avar[part],
            tensor,
            self.slope,
            self.duration,
            detrended=self.detrended,
            correlated=None if self.correlated is None else self.correlated[part],
        )

    def residuals(self, terms: NoiseParameters) -> tuple[Array, Array]:
        """Return the (M, P) whitened residuals of the cube roots and the (M,) log-determinant terms.

        A filter of finite memory adds a multiple of 1 / tau^2 to N^2 / tau for averaging times beyond its
        length; the degrees of freedom do not change.
        """
        theta = terms.theta
        count, points = len(theta), len(self.tau)
        plain = theta @ self._design.T
        band = (terms.band * theta[:, N])[:, None] * (self.tau[0] / self.tau**2)
        mean = plain + band + (0.0 if self.correlated is None else self.correlated)
        products = (theta[:, :, None] * theta[:, None, :]).reshape(count, 25)
        covariance = (products @ self._flat_tensor).reshape(count, points, points)
        variance = covariance.diagonal(axis1=1, axis2=2)
        spread = variance / plain**2 + self.misfit**2
        root = np.sqrt(spread)
        residual = (np.cbrt(self.avar / mean) - (1.0 - spread / 9.0)) * 3.0 / root
        outer = plain * root
        correlation = covariance / (outer[:, :, None] * outer[:, None, :])
        correlation.reshape(count, -1)[:, :: points + 1] = 1.0 + _CORRELATION_RIDGE
        factor = np.linalg.cholesky(correlation)
        log_volume = np.log(factor.diagonal(axis1=1, axis2=2) ** 2 * spread) + 2.0 / 3.0 * np.log(mean)
        return np.linalg.solve(factor, residual[:, :, None])[:, :, 0], log_volume.sum(axis=1)

    def chi2(self, x: Array) -> float:
        """Return the sum of squares of the whitened residuals at x, (6,)."""
        residual, _ = self.residuals(NoiseParameters.from_vector(x[None]))
        return float(np.sum(residual**2))

    def cost(self, x: Array) -> float:
        """Return -2 ln likelihood of points and slope at x, (6,), up to a constant."""
        residual, volume = self.cost_parts(x[None])
        return float(np.sum(residual**2) + volume[0])

    def cost_parts(self, x: Array) -> tuple[Array, Array]:
        """Return the whitened residuals at M points x, (M, 6), and the (M,) remainder.

        Cost = sum of squares + remainder.
        """
        terms = NoiseParameters.from_vector(x)
        residual, volume = self.residuals(terms)
        spread = slope_sigma(terms.theta, self.duration)
        slope_residual = (self.slope - terms.ramp) / spread
        return np.concatenate([residual, slope_residual[:, None]], axis=1), volume + 2.0 * np.log(spread)

    def maximise(
        self, active: Sequence[int], start: Array | None = None, fixed: Mapping[int, float] | None = None
    ) -> LikelihoodMaximum:
        """Maximise the likelihood over the active terms, with `fixed` ones held and all others absent.

        start: (6,) initial vector, by default `initial_guess`. N must be active.
        """
        fixed = fixed or {}
        free = [term for term in active if term not in fixed]
        x = self.starting_point(active, self.initial_guess(active) if start is None else start, fixed)
        if not free:
            return LikelihoodMaximum(x, tuple(active), self.cost(x))
        scale = np.array(
            [
                slope_sigma(NoiseParameters.from_vector(x).theta, self.duration) if k == R else 1.0
                for k in free
            ]
        )
        low, high = self.bounds(free)

        def full_vector(step: Array) -> Array:
            full = np.empty((*step.shape[:-1], len(x)))
            full[:] = x
            full[..., free] = step * scale
            return full

        solution, cost = minimise(lambda step: self.cost_parts(full_vector(step)), x[free] / scale, low, high)
        return LikelihoodMaximum(full_vector(solution[None])[0], tuple(active), cost)

    def starting_point(
        self, active: Sequence[int], start: Array, fixed: Mapping[int, float] | None = None
    ) -> Array:
        """Return the vector, (6,), at which a search from `start` begins; terms not active are absent.

        Where a term is negligible the cost is flat, so the search does not start there.
        """
        x, fixed, largest = start.copy(), fixed or {}, self._largest_log_squares()
        for term in range(6):
            if term not in active:
                x[term] = ABSENT_LOG_SQUARE if term < R else 0.0
            elif term in fixed:
                x[term] = fixed[term]
            elif term < R:
                x[term] = max(x[term], largest[term] - _START_LOG_RANGE)
        return x

    def bounds(self, free: Sequence[int]) -> tuple[Array, Array]:
        """Return the lowest and highest values of free terms, (n,) each; R has none."""
        largest = np.append(self._largest_log_squares(), (np.inf, np.inf))
        low = [-np.inf if k == R else -3.0 if k == BAND else largest[k] - 2.0 * _MAX_LOG_RANGE for k in free]
        high = [np.inf if k == R else _MAX_LOG_RANGE if k == BAND else largest[k] + 5.0 for k in free]
        return np.array(low), np.array(high)

    def initial_guess(self, active: Sequence[int]) -> Array:
        """Return an initial vector, (6,): each term slightly below the largest that the points allow."""
        x = np.full(6, ABSENT_LOG_SQUARE)
        x[[R, BAND]] = self.slope if R in active else 0.0, 0.0
        largest = self._largest_log_squares()
        for term in active:
            if term < R:
                x[term] = largest[term] - (0.1 if term == N else 1.0)
        return x

    def _largest_log_squares(self) -> Array:
        """Return the (4,) largest log squares of Q, N, B, K that alone do not exceed any point."""
        largest: Array = np.log(np.min(self.avar[:, None] / self._design[:, :R], axis=0))
        return largest


def slope_sigma(theta: Array, duration: float) -> Array:
    """Return the standard deviation of the least-squares slope of a record, unit/s.

    theta: (..., 5) squares of the terms. duration: s. The variance is the integral of each noise density
    over the squared frequency response of the slope.
    """
    sigma: Array = np.sqrt(theta[..., :R] @ _slope_variance_weights(duration))
    return sigma


@lru_cache
def _slope_variance_weights(t: float) -> Array:
    """Return the (4,) weights of Q^2, N^2, B^2, K^2 in the variance of the slope of a record of t seconds."""
    return np.array([72.0 / t**4, 12.0 / t**3, 9.0 / np.pi / t**2, 1.2 / t])
