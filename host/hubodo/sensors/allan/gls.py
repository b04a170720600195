"""Generalised least squares for the squares of the noise terms, weighted as the solution itself implies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from hubodo.sensors.allan.covariance import point_covariance

FloatArray = NDArray[np.float64]

Q, N, B, K, R = range(5)
"""Places of the terms in theta, (5,), the squares of Q, N, B, K, R."""

_ROUNDS = 12
_FLICKER_FOLDED = 0.11
# A model error is taken on when it raises twice the log-likelihood by this much.
_CLEARLY = 6.6
_FINEST = 1e-12


class Gls:
    """Generalised least squares with the covariance that the solution itself implies."""

    def __init__(
        self,
        matrix: FloatArray,
        avar: FloatArray,
        tensor: FloatArray,
        factors: NDArray[np.int64],
        misfit: float = 0.0,
    ) -> None:
        self._matrix, self._avar, self._tensor, self._factors = matrix, avar, tensor, factors
        self.relative_misfit = misfit
        # Sampled at points or averaged over the interval: at factor m a walk differs by 1 / (2 m^2); flicker
        # noise by what it has above the sampling rate, folded down or cut off, about a tenth of B^2 / m,
        # which looks like white noise. The record does not say which it was, and the error is the same at all
        # factors.
        m = factors.astype(float)
        self._sampling = {B: _FLICKER_FOLDED / m, K: 0.5 / m**2 * matrix[:, K]}
        self.starts_late = bool(factors[0] > 1)
        self.theta = np.zeros(matrix.shape[1])
        self._white_matrix, self._white = matrix, avar

    def again(self) -> Gls:
        """The same problem, not yet solved."""
        return Gls(self._matrix, self._avar, self._tensor, self._factors, self.relative_misfit)

    def weigh(self, theta: FloatArray) -> Gls:
        """Take the covariance from theta; returns self."""
        covariance = self._covariance(theta, self.relative_misfit)
        # Points scaled to variance 1: the terms span many decades.
        scale = np.sqrt(np.diag(covariance))
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        # The sums over lags are good to about 1e-3: a combination of points cannot be trusted beyond that.
        whiten = vectors.T / np.sqrt(np.maximum(values, 1e-3))[:, None]
        self._white_matrix = whiten @ (self._matrix / scale[:, None])
        self._white = whiten @ (self._avar / scale)
        self.theta = theta
        return self

    def solve(self, active: list[int]) -> Gls:
        """Iterate weights and solution for these terms; returns self."""
        theta = np.zeros(5)
        theta[active] = _bounded(self._matrix[:, active] / self._avar[:, None], np.ones_like(self._avar))
        for _ in range(_ROUNDS):
            self.weigh(theta)
            new = np.zeros(5)
            new[active] = _bounded(self._white_matrix[:, active], self._white)
            done = np.allclose(new, theta, rtol=1e-6, atol=0.0)
            # Half steps keep the alternation of weights and solution from oscillating.
            theta = new if done else 0.5 * (theta + new)
            if done:
                break
        self.theta = theta
        return self

    def chi2(self, theta: FloatArray) -> float:
        return float(np.sum((self._white_matrix @ theta - self._white) ** 2))

    def cost_without(self, term: int) -> float:
        """Rise of chi-square when the others must do without this term, weights unchanged."""
        others = [k for k in np.flatnonzero(self.theta) if k != term]
        if self.theta[term] == 0.0:
            return 0.0
        if not others:
            return np.inf
        theta = np.zeros(5)
        theta[others] = _bounded(self._white_matrix[:, others], self._white)
        return self.chi2(theta) - self.chi2(self.theta)

    def misfit(self) -> float:
        """Relative model error under which the residuals are most likely; mostly 0.

        It is taken as independent from point to point.
        """
        model = self._matrix @ self.theta
        residual = self._avar - model

        def surprise(relative: float) -> float:
            covariance = self._covariance(self.theta, relative) / np.outer(model, model)
            values, vectors = np.linalg.eigh(covariance)
            values = np.maximum(values, _FINEST)
            return float(np.sum(np.log(values)) + np.sum((vectors.T @ (residual / model)) ** 2 / values))

        sizes = np.geomspace(1e-3, 1.0, 31)
        found = [surprise(float(size)) for size in sizes]
        best = int(np.argmin(found))
        return float(sizes[best]) if found[best] < surprise(0.0) - _CLEARLY else 0.0

    def excess(self) -> float:
        """Chi-square per degree of freedom where it is above 1, else 1.

        Its root is what the error bars are too small by.
        """
        dof = max(1, len(self._avar) - int(np.count_nonzero(self.theta)))
        return max(1.0, self.chi2(self.theta) / dof)

    def _covariance(self, theta: FloatArray, misfit: float) -> FloatArray:
        model = self._matrix @ theta
        made: FloatArray = point_covariance(self._tensor, theta) + np.diag((misfit * model) ** 2)
        for term, error in self._sampling.items():
            made += np.outer(error, error) * theta[term] ** 2
        return made

    def parameter_covariance(self, active: list[int]) -> FloatArray:
        part = self._white_matrix[:, active]
        scale = np.linalg.norm(part, axis=0)
        inverse = np.linalg.pinv((part / scale).T @ (part / scale))
        made: FloatArray = self.excess() * inverse / np.outer(scale, scale)
        return made

    def estimate_with(self, term: int, active: list[int]) -> tuple[float, float]:
        """Square of a term that was left out, were it let in (not negative), and its sigma."""
        both = [*active, term]
        part = self._white_matrix[:, both]
        found = _bounded(part, self._white)
        return float(found[-1]), float(np.sqrt(self.parameter_covariance(both)[-1, -1]))


def _bounded(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Least squares without negative unknowns, columns scaled."""
    scale = np.linalg.norm(matrix, axis=0)
    found, _ = nnls(matrix / scale, right)
    made: FloatArray = found / scale
    return made
