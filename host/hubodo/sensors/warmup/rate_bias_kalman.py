"""Rate and bias of one gyro axis with a constant gain: the Kalman filter of Shah et al., eq. 4-12.

The model is z = rate + bias + v, both states random walks: F = 0, H = [1 1], Q = diag(q_w, q_b). With the
steady gain k = [k1, k2]' eq. 9 reads X' = -M X + k z, M = k H, lambda = k1 + k2. The closed form of eq.
10-11 follows without eigenvectors: M M = k (H k) H = lambda M, so the series of the exponential sums to

    e^(-M t) = I - M (1 - e^(-lambda t)) / lambda,
    int_0^T e^(-M t) dt k = int_0^T e^(-lambda t) dt k = g k,   g = (1 - e^(-lambda T)) / lambda,

the second because M k = lambda k. With z held over T that is X += g k (z - rate - bias). Summing both rows,
the sum s = rate + bias is a low-pass of the first order, s += (1 - e^(-lambda T)) (z - s), and rate and bias
move along it in the proportion k1 : k2, always:

    rate = rate_0 + k1 / lambda (s - s_0),   bias = bias_0 + k2 / lambda (s - s_0).

So what the filter learns is s. The observability matrix [H; H F] has rank 1: the split of s into rate and
bias is where it was at the start, plus the proportion; no data ever correct it. P grows without bound along
[1, -1], while the gain settles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_MOST_STEPS = 1_000_000


@dataclass(frozen=True)
class Gain:
    """k1 and k2 of eq. 9 in 1/s: `rate` > 0, `bias` >= 0. ValueError otherwise."""

    rate: float
    bias: float

    def __post_init__(self) -> None:
        if not (0.0 < self.rate < math.inf and 0.0 <= self.bias < math.inf):
            raise ValueError(
                f"gain {self.rate}, {self.bias}: the first must be above 0, the second at least 0"
            )

    def per_sample(self, dt: float) -> tuple[float, float]:
        """g k of eq. 11: what one sample's residual adds to rate and bias; the firmware's two constants."""
        take = _take(self, dt)
        total = self.rate + self.bias
        return take * self.rate / total, take * self.bias / total


@dataclass(frozen=True)
class RateBias:
    """rate, bias: (N,) rad/s after each sample. Only their sum is observable, see `RateBiasKalman.bias`."""

    rate: FloatArray
    bias: FloatArray


def steady_gain(rate_step: float, bias_step: float, noise: float, dt: float) -> Gain:
    """The gain that eq. 6-8 settle at, turned into that of eq. 9.

    rate_step, bias_step: rad/s, 1 sigma by which rate and bias walk in one sample (the roots of q_w and q_b
    of eq. 5); noise: rad/s, 1 sigma of a sample. Eq. 6-8 are discrete, K is what one sample adds; eq. 9 is
    continuous. Here lambda = -ln(1 - K1 - K2) / dt, with which the closed form repeats the discrete filter
    exactly. (K itself taken for a rate in 1/s would make the filter slower by 1 / dt.)
    ValueError unless rate_step > 0, bias_step >= 0, noise > 0, or where the recursion does not settle.
    """
    if not (rate_step > 0.0 and bias_step >= 0.0 and noise > 0.0):
        raise ValueError("rate_step and noise must be above 0, bias_step at least 0")
    on_rate, on_bias = riccati_gain(rate_step**2, bias_step**2, noise**2)
    total = on_rate + on_bias
    decay = -math.log1p(-total) / dt
    return Gain(decay * on_rate / total, decay * on_bias / total)


def riccati_gain(q_w: float, q_b: float, q_n: float) -> tuple[float, float]:
    """K of eq. 6-8 with F = I, repeated until it changes by less than 1e-12 of itself. ValueError: never.

    P starts at Q. What P holds along [1, -1] grows for ever and never enters the gain.
    """
    pww, pwb, pbb = 0.0, 0.0, 0.0
    before = 0.0
    for _ in range(_MOST_STEPS):
        pww, pbb = pww + q_w, pbb + q_b
        seen_w, seen_b = pww + pwb, pwb + pbb
        scale = 1.0 / (seen_w + seen_b + q_n)
        gw, gb = seen_w * scale, seen_b * scale
        # Eq. 8 written out: (I - K H) P (I - K H)' + K R K'.
        aw, ab = 1.0 - gw, 1.0 - gb
        xw, xb = aw * pww - gw * pwb, aw * pwb - gw * pbb
        yw, yb = ab * pwb - gb * pww, ab * pbb - gb * pwb
        pww = aw * xw - gw * xb + gw * gw * q_n
        pwb = ab * xb - gb * xw + gw * gb * q_n
        pbb = ab * yb - gb * yw + gb * gb * q_n
        if abs(gw + gb - before) <= 1e-12 * (gw + gb):
            return gw, gb
        before = gw + gb
    raise ValueError(f"the gain for q_w {q_w}, q_b {q_b}, q_n {q_n} has not settled in {_MOST_STEPS} samples")


def closed_form(gain: Gain, dt: float) -> tuple[FloatArray, FloatArray]:
    """e^(-M T), (2, 2), and int_0^T e^(-M t) dt k, (2,), of eq. 10-11."""
    drive = np.array(gain.per_sample(dt))
    return np.eye(2) - drive[:, None], drive


class RateBiasKalman:
    """Eq. 10-12 for one axis, sample by sample.

    gain: of eq. 9. dt: s between samples. rate, bias: rad/s at the start. ValueError for dt <= 0.
    """

    __slots__ = ("_bias_at_zero", "_bias_share", "_keep", "_rate_at_zero", "_rate_share", "_sum", "_take")

    def __init__(self, gain: Gain, dt: float, *, rate: float = 0.0, bias: float = 0.0) -> None:
        if not dt > 0.0:
            raise ValueError(f"dt {dt} s: must be above 0")
        self._take = _take(gain, dt)
        self._keep = 1.0 - self._take
        self._rate_share = gain.rate / (gain.rate + gain.bias)
        self._bias_share = gain.bias / (gain.rate + gain.bias)
        self._sum = rate + bias
        self._rate_at_zero = rate - self._rate_share * self._sum
        self._bias_at_zero = bias - self._bias_share * self._sum

    def update(self, z: float) -> float:
        """Takes a sample, rad/s; returns the rate."""
        self._sum = total = self._keep * self._sum + self._take * z
        return self._rate_at_zero + self._rate_share * total

    @property
    def rate(self) -> float:
        """rad/s. Only its sum with the bias is observable (rank 1)."""
        return self._rate_at_zero + self._rate_share * self._sum

    @property
    def bias(self) -> float:
        """rad/s.

        Not observable by itself: the observability matrix has rank 1. It is the bias at the start plus k2 /
        (k1 + k2) of all that rate + bias has moved since, a true turn included.
        """
        return self._bias_at_zero + self._bias_share * self._sum

    def run(self, z: FloatArray) -> RateBias:
        """Takes (N,) samples, rad/s, as N calls of `update` would.

        The same operations in the same order: equal bit for bit where scipy's `lfilter` is compiled without
        fused multiply-add (x86-64 wheels), to rounding elsewhere. ValueError for samples that are not finite.
        """
        samples = np.asarray(z, dtype=np.float64)
        if samples.ndim != 1 or not np.isfinite(samples).all():
            raise ValueError(f"samples of shape {samples.shape}: must be (N,) and finite")
        if not samples.size:
            return RateBias(samples, samples)
        # It takes half a second to load, with what it brings along, and only records at rest ask for it.
        from scipy.signal import lfilter

        totals: FloatArray
        totals, _ = lfilter([self._take], [1.0, -self._keep], samples, zi=[self._keep * self._sum])
        self._sum = float(totals[-1])
        return RateBias(
            self._rate_at_zero + self._rate_share * totals, self._bias_at_zero + self._bias_share * totals
        )


def _take(gain: Gain, dt: float) -> float:
    return -math.expm1(-(gain.rate + gain.bias) * dt)
