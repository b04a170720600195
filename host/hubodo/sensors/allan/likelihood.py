"""How likely an Allan deviation is for given noise terms, and the terms that make it most so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hubodo.sensors.allan.covariance import covariance_tensor, design
from hubodo.sensors.allan.descent import descend
from hubodo.sensors.allan.deviation import AllanPoints

FloatArray = NDArray[np.float64]

Q, N, B, K, R, BAND = range(6)
"""Places of the terms in x, (6,): logarithms of the squares of Q, N, B, K; R; and ln(1 + band)."""

ABSENT = -80.0
_FLICKER_FOLDED = 0.11
# The sums over lags in the covariance are good to about this: no combination of points is trusted beyond it.
_RIDGE = 1e-3
_FARTHEST, _IN_SIGHT = 12.0, 4.0


@dataclass(frozen=True)
class Terms:
    """A point in the space of noise terms, or M of them.

    theta: (5,) or (M, 5) squares of Q, N, B, K, R, with the sign of the ramp aside. ramp: with it. band: by
    how much the variance of the white noise differs at the first averaging time used, relative to it: below 0
    behind a low-pass.
    """

    theta: FloatArray
    ramp: FloatArray
    band: FloatArray

    @classmethod
    def of(cls, x: FloatArray) -> Terms:
        """x: (6,) or (M, 6)."""
        theta = np.where(x[..., :5] <= ABSENT, 0.0, np.exp(x[..., :5]))
        theta[..., R] = x[..., R] ** 2
        return cls(theta, x[..., R], np.expm1(x[..., BAND]))


@dataclass(frozen=True)
class Maximum:
    """The most likely terms: x, those that were free, and -2 ln of the likelihood."""

    x: FloatArray
    active: tuple[int, ...]
    cost: float


@dataclass
class Likelihood:
    """Octaves of an Allan variance and the slope of the record, as random numbers that depend on the terms.

    An overlapping Allan variance is close to a multiple of chi-square with as many degrees of freedom as its
    mean and variance say, and the cube root of that is close to Gaussian (Wilson and Hilferty 1931); the
    correlation of the points is that of `covariance_tensor`. The slope is Gaussian with the variance that
    the terms give it.

    points: of a record; start: place of the first octave in use; misfit: relative error of the model itself,
    independent from point to point. level: the points are of the record less its slope, which
    alone tells the ramp then: both would tell it twice.
    """

    factors: NDArray[np.int64]
    tau: FloatArray
    avar: FloatArray
    tensor: FloatArray
    slope: float
    duration: float
    misfit: float = 0.0
    level: bool = False
    _flat: FloatArray = field(init=False, repr=False)
    _matrix: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._matrix = design(self.tau)
        if self.level:
            self._matrix[:, R] = 0.0
        # Sampled at points or averaged over the interval: at factor m a walk differs by 1 / (2 m^2); flicker
        # noise by what it has above the sampling rate, folded down or cut off, about a tenth of B^2 / m,
        # which looks like white noise, and as much again of a shape like that of quantisation. The record
        # does not say which it was, and the error is the same at all factors.
        m = self.factors.astype(float)
        walk = 0.5 / m**2 * self._matrix[:, K]
        folded = np.outer(1.0 / m, 1.0 / m) + np.outer(m**-2, m**-2)
        tensor = self.tensor.copy()
        tensor[:, :, B, B] += _FLICKER_FOLDED**2 * folded
        tensor[:, :, K, K] += np.outer(walk, walk)
        self._flat = tensor.reshape(len(self.tau) ** 2, 25).T.copy()

    @classmethod
    def of(
        cls, points: AllanPoints, used: NDArray[np.bool_], slope: float, *, level: bool = False
    ) -> Likelihood:
        """The points chosen by used, (P,)."""
        factors, tau = points.factors[used], points.tau[used]
        tensor = covariance_tensor(factors, points.samples, points.dt)
        # Gaps leave fewer pairs than the covariance of a complete record counts on.
        lost = (points.samples - 2 * factors + 1) / points.pairs[used]
        tensor *= np.sqrt(np.outer(lost, lost))[:, :, None, None]
        duration = points.samples * points.dt
        if level:
            tensor[:, :, R, :] = tensor[:, :, :, R] = 0.0
        return cls(factors, tau, points.adev[used] ** 2, tensor, slope, duration, level=level)

    def later(self, start: int) -> Likelihood:
        """The same from the octave `start` on."""
        part = slice(start, None)
        tensor = self.tensor[part, part]
        return Likelihood(
            self.factors[part],
            self.tau[part],
            self.avar[part],
            tensor,
            self.slope,
            self.duration,
            level=self.level,
        )

    def residuals(self, terms: Terms) -> tuple[FloatArray, FloatArray]:
        """(M, P) independent residuals of the cube roots, of variance 1, and the log of the volume, (M,).

        A finite memory adds a multiple of 1 / tau^2 to N^2 / tau beyond its length, and leaves the degrees of
        freedom what they are.
        """
        theta = terms.theta
        count, points = len(theta), len(self.tau)
        plain = theta @ self._matrix.T
        band = (terms.band * theta[:, N])[:, None] * (self.tau[0] / self.tau**2)
        mean = plain + band
        products = (theta[:, :, None] * theta[:, None, :]).reshape(count, 25)
        covariance = (products @ self._flat).reshape(count, points, points)
        own = covariance.diagonal(axis1=1, axis2=2)
        spread = own / plain**2 + self.misfit**2
        root = np.sqrt(spread)
        residual = (np.cbrt(self.avar / mean) - (1.0 - spread / 9.0)) * 3.0 / root
        outer = plain * root
        correlation = covariance / (outer[:, :, None] * outer[:, None, :])
        correlation.reshape(count, -1)[:, :: points + 1] = 1.0 + _RIDGE
        factor = np.linalg.cholesky(correlation)
        inner = np.log(factor.diagonal(axis1=1, axis2=2) ** 2 * spread) + 2.0 / 3.0 * np.log(mean)
        return np.linalg.solve(factor, residual[:, :, None])[:, :, 0], inner.sum(axis=1)

    def chi2(self, x: FloatArray) -> float:
        """Sum of squares of the residuals made independent; x: (6,)."""
        residual, _ = self.residuals(Terms.of(x[None]))
        return float(np.sum(residual**2))

    def cost(self, x: FloatArray) -> float:
        """-2 ln of the likelihood of points and slope, but for a constant; x: (6,)."""
        residual, volume = self.parts(x[None])
        return float(np.sum(residual**2) + volume[0])

    def parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same at M points, (M, 6), as independent residuals to be squared, and what is added to them."""
        terms = Terms.of(x)
        residual, volume = self.residuals(terms)
        spread = slope_sigma(terms.theta, self.duration)
        off = (self.slope - terms.ramp) / spread
        return np.concatenate([residual, off[:, None]], axis=1), volume + 2.0 * np.log(spread)

    def best(
        self, active: Sequence[int], start: FloatArray | None = None, held: Mapping[int, float] | None = None
    ) -> Maximum:
        """The most likely values of the active terms; the others are absent, held ones as given.

        start: (6,) where to begin. N is always there.
        """
        x = self.guess(active) if start is None else start.copy()
        held = held or {}
        free = [term for term in active if term not in held]
        top = np.append(self._largest(), (np.inf, np.inf))
        for term in range(6):
            if term not in active:
                x[term] = ABSENT if term < R else 0.0
            elif term in held:
                x[term] = held[term]
            elif term < R:
                # A term lost sight of has no slope to come back by.
                x[term] = max(x[term], top[term] - _IN_SIGHT)
        if not free:
            return Maximum(x, tuple(active), self.cost(x))
        scale = np.array([slope_sigma(Terms.of(x).theta, self.duration) if k == R else 1.0 for k in free])
        low = np.array([-np.inf if k == R else -3.0 if k == BAND else top[k] - 2.0 * _FARTHEST for k in free])
        high = np.array([np.inf if k == R else _FARTHEST if k == BAND else top[k] + 5.0 for k in free])

        def moved(step: FloatArray) -> FloatArray:
            made = np.empty((*step.shape[:-1], len(x)))
            made[:] = x
            made[..., free] = step * scale
            return made

        found, cost = descend(lambda step: self.parts(moved(step)), x[free] / scale, low, high)
        return Maximum(moved(found[None])[0], tuple(active), cost)

    def guess(self, active: Sequence[int]) -> FloatArray:
        """(6,) a point to begin at: each term as large as the points allow, less a little."""
        x = np.full(6, ABSENT)
        x[[R, BAND]] = self.slope if R in active else 0.0, 0.0
        top = self._largest()
        for term in active:
            if term < R:
                x[term] = top[term] - (0.1 if term == N else 1.0)
        return x

    def _largest(self) -> FloatArray:
        """(4,) logarithm of the square of each term but R that alone would make some point what it is."""
        made: FloatArray = np.log(np.min(self.avar[:, None] / self._matrix[:, :R], axis=0))
        return made


def slope_sigma(theta: FloatArray, duration: float) -> FloatArray:
    """1 sigma of the least-squares slope of a record, unit/s, of each of (..., 5) squares of the terms.

    duration: s. The integral of each noise density over the response of the slope to a frequency.
    """
    made: FloatArray = np.sqrt(theta[..., :R] @ _shares_of_slope(duration))
    return made


@lru_cache
def _shares_of_slope(t: float) -> FloatArray:
    """(4,) of the squares of Q, N, B, K in the variance of the slope of a record of t seconds."""
    return np.array([72.0 / t**4, 12.0 / t**3, 9.0 / np.pi / t**2, 1.2 / t])
