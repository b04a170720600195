"""Rate of one gyro axis by recursive least squares with forgetting: the filter of Shah et al., eq. 13-14.

As printed, y_n = z_n is fitted by x_n b, x_n = [n, yhat_(n-1) - y_n], with weights lambda^(N - n), and the
estimate is yhat_n = x_n b_n with the b already updated with y_n ("in the same iteration"). The paper
leaves some choices open. Here n counts samples from 1, yhat_0 = 0, and the static bias is subtracted from
each sample, because the second element of b is dimensionless and cannot represent it.

Behaviour: over its memory of 1 / (1 - lambda) samples, b_1 n is close to a constant, the mean level (as a
line through n = 0, it leads by 1 / ((1 - lambda) n) of the level); b_2 adds a fraction of the difference
between sample and last estimate. At a constant rate in white noise the best -b_2 is the root of a^2 + a =
1, 0.618, and yhat retains 0.618 of the noise variance however long the memory is, because the regressor
contains y_n. While the rate changes, the level lags by the memory. `lagged` selects the other
interpretation, x_n = [n, yhat_(n-1) - y_(n-1)], which uses only data before y_n; its noise decreases with
the memory.

Numerical safeguards: if yhat - y stays zero (constant, quantised samples), b_2 is not excited and its
variance grows as lambda^-n, which would overflow in six minutes at 100 Hz. It is limited to
`_MAX_VARIANCE` by scaling that row and column of P, which keeps P positive and leaves b_1 unchanged. P is
stored as three numbers and so is symmetric. n is a float, exact to 2^53 samples.
"""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array

_State = tuple[float, float, float, float, float, float, float]
"""n, yhat, b_1, b_2, P_11, P_12, P_22."""

_INITIAL_VARIANCE = 1e6
"""Initial variances in P: an uninformative prior of b."""

_MAX_VARIANCE = 1e9
"""Reached if yhat - y stays below 3e-5 rad/s, 1 / sqrt(_MAX_VARIANCE), less than a gyro's quantisation step.
"""


class RecursiveLeastSquares:
    """A recursive least-squares filter of one gyro axis (eq. 13-14), sample by sample.

    forgetting: lambda in (0, 1]. bias: static bias, rad/s, subtracted from each sample. lagged: use the
    regressor without the current sample (module docstring). Raises ValueError for a lambda out of range.
    """

    __slots__ = ("_bias", "_forgetting", "_inverse_forgetting", "_lagged", "_last", "_state")

    def __init__(self, forgetting: float, *, bias: float = 0.0, lagged: bool = False) -> None:
        if not 0.0 < forgetting <= 1.0:
            raise ValueError(f"forgetting factor {forgetting}: must be in (0, 1]")
        self._forgetting, self._inverse_forgetting = forgetting, 1.0 / forgetting
        self._bias = bias
        self._lagged = lagged
        self._last = 0.0
        self._state: _State = (0.0, 0.0, 0.0, 0.0, _INITIAL_VARIANCE, 0.0, _INITIAL_VARIANCE)

    @property
    def rate(self) -> float:
        """Return the rate yhat, rad/s.

        Only the sum of rate and bias is observable, so errors of `bias` remain.
        """
        return self._state[1]

    @property
    def coefficients(self) -> tuple[float, float]:
        """Return b: b_1 in rad/s per sample, and b_2, dimensionless."""
        return self._state[2:4]

    @property
    def covariance(self) -> Array:
        """Return P, (2, 2)."""
        p11, p12, p22 = self._state[4:]
        return np.array([[p11, p12], [p12, p22]])

    def update(self, z: float) -> float:
        """Process a sample, rad/s, and return the rate, rad/s."""
        # All in one function with plain floats, because calls are half the time of a live update.
        n, last_rate, b1, b2, p11, p12, p22 = self._state
        y = z - self._bias
        e = last_rate - y
        if self._lagged:
            e, self._last = last_rate - self._last, y
        n += 1.0
        g1 = p11 * n + p12 * e
        g2 = p12 * n + p22 * e
        forgetting, inverse_forgetting = self._forgetting, self._inverse_forgetting
        # g * scale is P_(n+1) x, the gain of eq. 13.
        scale = 1.0 / (forgetting + n * g1 + e * g2)
        k1 = scale * g1
        k2 = scale * g2
        step = y - n * b1 - e * b2
        p12 = (p12 - k1 * g2) * inverse_forgetting
        p22 = (p22 - k2 * g2) * inverse_forgetting
        if p22 > _MAX_VARIANCE:
            p12 *= math.sqrt(_MAX_VARIANCE / p22)
            p22 = _MAX_VARIANCE
        # The updated n b_1 + e b_2: after eq. 13 the residual is lambda * scale times the previous one.
        rate = y - forgetting * scale * step
        self._state = n, rate, b1 + k1 * step, b2 + k2 * step, (p11 - k1 * g1) * inverse_forgetting, p12, p22
        return rate

    def run(self, z: Array) -> Array:
        """Process (N,) samples, rad/s, and return the (N,) rates, bit-identical to N calls of `update`.

        The regressor contains the last estimate, so the recursion cannot be vectorised. Raises ValueError for
        samples that are not finite.
        """
        samples = np.array(z, dtype=np.float64)
        if samples.ndim != 1 or not np.isfinite(samples).all():
            raise ValueError(f"samples of shape {samples.shape}: must be (N,) and finite")
        return np.array([self.update(value) for value in samples.tolist()])
