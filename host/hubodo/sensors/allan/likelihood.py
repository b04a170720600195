"""How likely an Allan deviation is for given noise terms, and the terms that make it most so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtrs

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
    """A point in the space of noise terms.

    theta: (5,) squares of Q, N, B, K, R, with the sign of the ramp aside. band: by how much the variance of
    the white noise differs at the first averaging time used, relative to it: below 0 behind a low-pass.
    """

    theta: FloatArray
    ramp: float
    band: float

    @classmethod
    def of(cls, x: FloatArray) -> Terms:
        theta = np.exp(x[:5])
        theta[R] = x[R] ** 2
        theta[:R][x[:R] <= ABSENT] = 0.0
        return cls(theta, float(x[R]), float(np.expm1(x[BAND])))


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
    independent from point to point.
    """

    factors: NDArray[np.int64]
    tau: FloatArray
    avar: FloatArray
    tensor: FloatArray
    slope: float
    duration: float
    misfit: float = 0.0
    _flat: FloatArray = field(init=False, repr=False)
    _matrix: FloatArray = field(init=False, repr=False)
    _sampling: tuple[FloatArray, FloatArray] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._matrix = design(self.tau)
        self._flat = self.tensor.reshape(len(self.tau) ** 2, 25)
        # Sampled at points or averaged over the interval: at factor m a walk differs by 1 / (2 m^2); flicker
        # noise by what it has above the sampling rate, folded down or cut off, about a tenth of B^2 / m,
        # which looks like white noise. The record does not say which it was, and the error is the same at
        # all factors.
        m = self.factors.astype(float)
        walk = 0.5 / m**2 * self._matrix[:, K]
        self._sampling = np.outer(_FLICKER_FOLDED / m, _FLICKER_FOLDED / m), np.outer(walk, walk)

    @classmethod
    def of(cls, points: AllanPoints, used: NDArray[np.bool_], slope: float) -> Likelihood:
        """The points chosen by used, (P,)."""
        factors, tau = points.factors[used], points.tau[used]
        tensor = covariance_tensor(factors, points.samples, points.dt)
        # Gaps leave fewer pairs than the covariance of a complete record counts on.
        lost = (points.samples - 2 * factors + 1) / points.pairs[used]
        tensor *= np.sqrt(np.outer(lost, lost))[:, :, None, None]
        duration = points.samples * points.dt
        return cls(factors, tau, points.adev[used] ** 2, tensor, slope, duration)

    def later(self, start: int) -> Likelihood:
        """The same from the octave `start` on."""
        part = slice(start, None)
        return Likelihood(
            self.factors[part],
            self.tau[part],
            self.avar[part],
            self.tensor[part, part],
            self.slope,
            self.duration,
        )

    def variance(self, terms: Terms) -> FloatArray:
        """(P,) expected Allan variance."""
        made: FloatArray = self._matrix @ terms.theta + self._band(terms)
        return made

    def _band(self, terms: Terms) -> FloatArray:
        """(P,) what a finite memory adds to N^2 / tau: exactly c / tau^2 beyond its length."""
        made: FloatArray = terms.band * terms.theta[N] * self.tau[0] / self.tau**2
        return made

    def relative_covariance(self, terms: Terms) -> FloatArray:
        """(P, P) of the points over their means; a band leaves the degrees of freedom what they are."""
        theta = terms.theta
        plain = self._matrix @ theta
        made = (self._flat @ (theta[:, None] * theta).ravel()).reshape(len(plain), len(plain))
        made += self._sampling[0] * theta[B] ** 2 + self._sampling[1] * theta[K] ** 2
        made /= plain[:, None] * plain
        made.flat[:: len(plain) + 1] += self.misfit**2
        return made

    def residuals(self, terms: Terms) -> tuple[FloatArray, float]:
        """(P,) independent residuals of the cube roots, of variance 1, and the log of the volume."""
        relative = self.relative_covariance(terms)
        spread = np.diag(relative).copy()
        mean = self.variance(terms)
        sigma = np.sqrt(spread) / 3.0
        residual = (np.cbrt(self.avar / mean) - (1.0 - spread / 9.0)) / sigma
        root = np.sqrt(spread)
        correlation = relative / (root[:, None] * root)
        correlation.flat[:: len(mean) + 1] += _RIDGE
        # By LAPACK's names: for a dozen points the calls of linalg take longer than the sums.
        factor, failed = dpotrf(correlation, lower=1)
        if failed:
            raise np.linalg.LinAlgError("the covariance of the points is not positive")
        volume = np.sum(np.log(np.diag(factor) ** 2 * spread) + 2.0 / 3.0 * np.log(mean))
        return dtrtrs(factor, residual, lower=1)[0], float(volume)

    def chi2(self, terms: Terms) -> float:
        """Sum of squares of the residuals made independent."""
        residual, _ = self.residuals(terms)
        return float(residual @ residual)

    def cost(self, x: FloatArray) -> float:
        """-2 ln of the likelihood of points and slope, but for a constant."""
        residual, volume = self.parts(x)
        return float(residual @ residual + volume)

    def parts(self, x: FloatArray) -> tuple[FloatArray, float]:
        """The same as independent residuals to be squared, and what is added to their squares."""
        terms = Terms.of(x)
        residual, volume = self.residuals(terms)
        spread = slope_sigma(terms.theta, self.duration)
        off = (self.slope - terms.ramp) / spread
        return np.append(residual, off), volume + 2.0 * float(np.log(spread))

    def best(
        self, active: Sequence[int], start: FloatArray | None = None, held: Mapping[int, float] | None = None
    ) -> Maximum:
        """The most likely values of the active terms; the others are absent, held ones as given.

        start: (6,) where to begin. N is always there.
        """
        x = self.guess(active) if start is None else start.copy()
        held = held or {}
        free = [term for term in active if term not in held]
        top = np.append(self._largest()[:R], (np.inf, np.inf))
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
            made = x.copy()
            made[free] = step * scale
            return made

        found, cost = descend(lambda step: self.parts(moved(step)), x[free] / scale, low, high)
        return Maximum(moved(found), tuple(active), cost)

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
        """(5,) logarithm of the square of each term that alone would make some point what it is."""
        made: FloatArray = np.log(np.min(self.avar[:, None] / self._matrix, axis=0))
        return made


def slope_sigma(theta: FloatArray, duration: float) -> float:
    """1 sigma of the least-squares slope of a record, unit/s; theta: (5,) squares of the terms; duration: s.

    The integral of each noise density over the response of the slope to a frequency.
    """
    t = duration
    return float(
        np.sqrt(
            72.0 * theta[Q] / t**4
            + 12.0 * theta[N] / t**3
            + 9.0 / np.pi * theta[B] / t**2
            + 1.2 * theta[K] / t
        )
    )
