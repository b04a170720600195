"""Rate and bias of one gyro axis by a Kalman filter with constant gain (Shah et al., eq. 4-12).

The model is z = rate + bias + v, both states random walks: F = 0, H = [1 1], Q = diag(q_w, q_b). With the
steady gain k = [k1, k2]' eq. 9 reads X' = -M X + k z, M = k H, lambda = k1 + k2. The closed form of eq.
10-11 follows without eigenvectors: M M = k (H k) H = lambda M, so the series of the exponential sums to

    e^(-M t) = I - M (1 - e^(-lambda t)) / lambda,
    int_0^T e^(-M t) dt k = int_0^T e^(-lambda t) dt k = g k,   g = (1 - e^(-lambda T)) / lambda,

the second because M k = lambda k. With z held over T that is X += g k (z - rate - bias). Summing both rows,
the sum s = rate + bias is a first-order low-pass, s += (1 - e^(-lambda T)) (z - s), and rate and bias always
change in the proportion k1 : k2:

    rate = rate_0 + k1 / lambda (s - s_0),   bias = bias_0 + k2 / lambda (s - s_0).

So the filter estimates s only. The observability matrix [H; H F] has rank 1: the split of s into rate and
bias is the initial one plus that proportion, and data never correct it. P grows without bound along [1,
-1], while the gain converges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array

_MAX_RICCATI_STEPS = 1_000_000


@dataclass(frozen=True)
class KalmanGain:
    """The gains k1 (`rate` > 0) and k2 (`bias` >= 0) of eq. 9, 1/s; other values raise ValueError."""

    rate: float
    bias: float

    def __post_init__(self) -> None:
        if not (0.0 < self.rate < math.inf and 0.0 <= self.bias < math.inf):
            raise ValueError(
                f"gain {self.rate}, {self.bias}: the first must be above 0, the second at least 0"
            )

    def per_sample(self, dt: float) -> tuple[float, float]:
        """Return g k of eq. 11, the gains per sample of rate and bias (the two constants of the firmware)."""
        total_gain = _total_gain(self, dt)
        total = self.rate + self.bias
        return total_gain * self.rate / total, total_gain * self.bias / total


@dataclass(frozen=True)
class RateBiasEstimates:
    """The (N,) estimates of rate and bias, rad/s, after each sample; only their sum is observable."""

    rate: Array
    bias: Array


def steady_state_gain(rate_step: float, bias_step: float, noise: float, dt: float) -> KalmanGain:
    """Return the steady-state gain of eq. 6-8, converted to the continuous gain of eq. 9.

    rate_step, bias_step: standard deviations, rad/s, of the random walks of rate and bias per sample (the
    roots of q_w and q_b of eq. 5). noise: standard deviation of a sample, rad/s. Eq. 6-8 are discrete,
    with a gain K per sample; eq. 9 is continuous. With lambda = -ln(1 - K1 - K2) / dt the closed form
    equals the discrete filter exactly. (Using K as a rate in 1/s would slow the filter by 1 / dt.) Raises
    ValueError unless rate_step > 0, bias_step >= 0 and noise > 0, or if the recursion does not converge.
    """
    if not (rate_step > 0.0 and bias_step >= 0.0 and noise > 0.0):
        raise ValueError("rate_step and noise must be above 0, bias_step at least 0")
    rate_gain, bias_gain = riccati_gain(rate_step**2, bias_step**2, noise**2)
    total = rate_gain + bias_gain
    decay = -math.log1p(-total) / dt
    return KalmanGain(decay * rate_gain / total, decay * bias_gain / total)


def riccati_gain(q_w: float, q_b: float, q_n: float) -> tuple[float, float]:
    """Return K of eq. 6-8 with F = I, iterated until its relative change is below 1e-12.

    P starts at Q. The component of P along [1, -1] grows without bound but does not affect the gain. Raises
    ValueError if K does not converge.
    """
    pww, pwb, pbb = 0.0, 0.0, 0.0
    previous_gain = 0.0
    for _ in range(_MAX_RICCATI_STEPS):
        pww, pbb = pww + q_w, pbb + q_b
        s_w, s_b = pww + pwb, pwb + pbb
        scale = 1.0 / (s_w + s_b + q_n)
        gw, gb = s_w * scale, s_b * scale
        # Eq. 8 in components: (I - K H) P (I - K H)' + K R K'.
        aw, ab = 1.0 - gw, 1.0 - gb
        xw, xb = aw * pww - gw * pwb, aw * pwb - gw * pbb
        yw, yb = ab * pwb - gb * pww, ab * pbb - gb * pwb
        pww = aw * xw - gw * xb + gw * gw * q_n
        pwb = ab * xb - gb * xw + gw * gb * q_n
        pbb = ab * yb - gb * yw + gb * gb * q_n
        if abs(gw + gb - previous_gain) <= 1e-12 * (gw + gb):
            return gw, gb
        previous_gain = gw + gb
    raise ValueError(
        f"the gain for q_w {q_w}, q_b {q_b}, q_n {q_n} has not settled in {_MAX_RICCATI_STEPS} samples"
    )


def discretise(gain: KalmanGain, dt: float) -> tuple[Array, Array]:
    """Return e^(-M T), (2, 2), and int_0^T e^(-M t) dt k, (2,), of eq. 10-11."""
    input_vector = np.array(gain.per_sample(dt))
    return np.eye(2) - input_vector[:, None], input_vector


class RateBiasKalman:
    """A constant-gain Kalman filter of rate and bias of one gyro axis (eq. 10-12), sample by sample.

    gain: gain of eq. 9. dt: sample interval, s. rate, bias: initial values, rad/s. Raises ValueError for dt
    <= 0.
    """

    __slots__ = ("_bias_at_zero", "_bias_share", "_decay", "_gain", "_rate_at_zero", "_rate_share", "_sum")

    def __init__(self, gain: KalmanGain, dt: float, *, rate: float = 0.0, bias: float = 0.0) -> None:
        if not dt > 0.0:
            raise ValueError(f"dt {dt} s: must be above 0")
        self._gain = _total_gain(gain, dt)
        self._decay = 1.0 - self._gain
        self._rate_share = gain.rate / (gain.rate + gain.bias)
        self._bias_share = gain.bias / (gain.rate + gain.bias)
        self._sum = rate + bias
        self._rate_at_zero = rate - self._rate_share * self._sum
        self._bias_at_zero = bias - self._bias_share * self._sum

    def update(self, z: float) -> float:
        """Process a sample, rad/s, and return the rate, rad/s."""
        self._sum = total = self._decay * self._sum + self._gain * z
        return self._rate_at_zero + self._rate_share * total

    @property
    def rate(self) -> float:
        """Return the rate, rad/s; only its sum with the bias is observable (rank 1)."""
        return self._rate_at_zero + self._rate_share * self._sum

    @property
    def bias(self) -> float:
        """Return the bias, rad/s.

        It is not observable by itself, as the observability matrix has rank 1: it is the initial bias plus
        k2 / (k1 + k2) of the change of rate + bias since, including true rotation.
        """
        return self._bias_at_zero + self._bias_share * self._sum

    def run(self, z: Array) -> RateBiasEstimates:
        """Process (N,) samples, rad/s, like N calls of `update`.

        The results are bit-identical if scipy's `lfilter` is compiled without fused multiply-add (x86-64
        wheels), otherwise equal up to rounding. Raises ValueError for samples that are not finite.
        """
        samples = np.asarray(z, dtype=np.float64)
        if samples.ndim != 1 or not np.isfinite(samples).all():
            raise ValueError(f"samples of shape {samples.shape}: must be (N,) and finite")
        if not samples.size:
            return RateBiasEstimates(samples, samples)
        # scipy.signal takes half a second to import, and only the analysis of stationary records needs it.
        from scipy.signal import lfilter

        totals: Array
        totals, _ = lfilter([self._gain], [1.0, -self._decay], samples, zi=[self._decay * self._sum])
        self._sum = float(totals[-1])
        return RateBiasEstimates(
            self._rate_at_zero + self._rate_share * totals, self._bias_at_zero + self._bias_share * totals
        )


def _total_gain(gain: KalmanGain, dt: float) -> float:
    return -math.expm1(-(gain.rate + gain.bias) * dt)
