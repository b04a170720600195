"""Rate of one gyro axis by least squares that forget: the RLS filter of Shah et al., eq. 13-14.

As printed, y_n = z_n is fitted by x_n b, x_n = [n, yhat_(n-1) - y_n], with weights lambda^(N - n), and the
estimate is yhat_n = x_n b_n with the b that has already seen y_n ("in the same iteration"). Of what the paper
leaves open: n counts samples from 1; yhat_0 = 0; the static bias is taken off each sample, as the second
element of b has no unit and cannot hold it.

What that does: over the 1 / (1 - lambda) samples that it remembers, b_1 n is close to a constant, the mean
level (being a line through n = 0, it leads one by 1 / ((1 - lambda) n) of it); b_2 puts back a part of what
the sample differs from the last estimate. At a constant rate in white noise the best -b_2 is the root of
a^2 + a = 1, 0.618, and yhat keeps 0.618 of the noise's variance however long the memory: the regressor holds
y_n itself, so part of the noise is always fitted. While the rate changes, the level lags by the memory.
`lagged` is the other reading, x_n = [n, yhat_(n-1) - y_(n-1)]: what is known before y_n; the noise then
falls with the memory.

Numerical safeguards. Where yhat - y stays zero (constant, quantised samples) nothing excites b_2 and its
variance grows as lambda^-n, to overflow in six minutes at 100 Hz: it is held at `_WINDUP` by shrinking that
row and column of P, which leaves P positive and b_1 free. P is kept as three numbers, symmetric by
construction. n is a float: exact to 2^53 samples.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_State = tuple[float, float, float, float, float, float, float]
"""n, yhat, b_1, b_2, P_11, P_12, P_22."""

_SPREAD = 1e6
"""Variances in P at the start: no wish about b."""

_WINDUP = 1e9
"""Where the differences in memory are below 3e-5 rad/s, 1 / sqrt(_WINDUP): less than a gyro's step."""


class RecursiveLeastSquares:
    """Eq. 13-14 for one axis, sample by sample.

    forgetting: lambda in (0, 1]. bias: rad/s, static, taken off each sample. lagged: the other reading of x.
    ValueError for another lambda.
    """

    __slots__ = ("_bias", "_forgetting", "_grows", "_lagged", "_last", "_state")

    def __init__(self, forgetting: float, *, bias: float = 0.0, lagged: bool = False) -> None:
        if not 0.0 < forgetting <= 1.0:
            raise ValueError(f"forgetting factor {forgetting}: must be in (0, 1]")
        self._forgetting, self._grows = forgetting, 1.0 / forgetting
        self._bias = bias
        self._lagged = lagged
        self._last = 0.0
        self._state: _State = (0.0, 0.0, 0.0, 0.0, _SPREAD, 0.0, _SPREAD)

    @property
    def rate(self) -> float:
        """rad/s, yhat. Bias and rate enter only as their sum: it is right as far as the static bias is."""
        return self._state[1]

    @property
    def coefficients(self) -> tuple[float, float]:
        """b: rad/s per sample, and a pure number."""
        return self._state[2:4]

    @property
    def spread(self) -> FloatArray:
        """P, (2, 2)."""
        p11, p12, p22 = self._state[4:]
        return np.array([[p11, p12], [p12, p22]])

    def update(self, z: float) -> float:
        """Takes a sample, rad/s; returns the rate."""
        # One function and plain floats: half of the time of a live update is Python's own.
        n, before, b1, b2, p11, p12, p22 = self._state
        y = z - self._bias
        e = before - y
        if self._lagged:
            e, self._last = before - self._last, y
        n += 1.0
        g1 = p11 * n + p12 * e
        g2 = p12 * n + p22 * e
        forgetting, grows = self._forgetting, self._grows
        # g times scale is P_(n+1) x, the gain of eq. 13.
        scale = 1.0 / (forgetting + n * g1 + e * g2)
        k1 = scale * g1
        k2 = scale * g2
        step = y - n * b1 - e * b2
        p12 = (p12 - k1 * g2) * grows
        p22 = (p22 - k2 * g2) * grows
        if p22 > _WINDUP:
            p12 *= math.sqrt(_WINDUP / p22)
            p22 = _WINDUP
        # n b_1 + e b_2, as what eq. 13 leaves of the residual is lambda times scale of it.
        rate = y - forgetting * scale * step
        self._state = n, rate, b1 + k1 * step, b2 + k2 * step, (p11 - k1 * g1) * grows, p12, p22
        return rate

    def run(self, z: FloatArray) -> FloatArray:
        """Takes (N,) samples, rad/s, as N calls of `update` would, bit for bit; returns the rates, (N,).

        The regressor holds the last estimate, so no sample can be worked before the one in front of it, and
        there is no linear filter to hand the recording to: it is a loop. ValueError for samples that are not
        finite.
        """
        samples = np.array(z, dtype=np.float64)
        if samples.ndim != 1 or not np.isfinite(samples).all():
            raise ValueError(f"samples of shape {samples.shape}: must be (N,) and finite")
        return np.array([self.update(value) for value in samples.tolist()])
