"""Rate and bias of three gyro axes in integers: steady-state Kalman filter of Shah et al., eq. 4-12.

Per axis, with the sample z in gyro steps and the estimate x = [rate, bias]:
    r = z - rate - bias
    rate += k1 g r,  bias += k2 g r,  g = (1 - exp(-lambda T)) / lambda,  lambda = k1 + k2
which is eq. 10-11 in closed form: the matrix [[k1, k1], [k2, k2]] has the eigenvalues lambda and 0. The two
products k1 g and k2 g are constants that the host computes.

Number formats (Qn: an integer counts 2^-n gyro steps; for gains 2^-n):
    z          Q0   16 bit
    r          Q4   clipped to +-(2^20 - 1)
    k1 g       Q20  0 .. 2^20 - 1
    k2 g       Q30  0 .. 2^20 - 1, so at most 1/1024
    rate       Q4, its fraction Q24 in 0 .. 2^20 - 1
    bias       Q14, its fraction Q34 in 0 .. 2^20 - 1, clipped to +-2^29
The fractions make both sums exact. Only r is rounded, to 1/16 step. Rate and bias take the same r,
so a rounding e acts on their sum s as s += g lambda (z - s - e), which decays: s is off by at most 1/32 step
(and 2^-14 from the truncated fraction), bias by k2 / lambda and rate by k1 / lambda of that, at all times.
Every intermediate is within +-2^30.

Only the sum of rate and bias is observable: the observability matrix has rank 1. `rate + bias` follows the
gyro; its split depends on the initial bias (`bias_choice.py`) and on the ratio k2 : k1.
"""

from array import array

from micropython import const

GAIN_LIMIT = const(1 << 20)
"""Upper bound on both gains."""

# Indices into the state of one axis, an array of int32.
_KF_RATE = const(0)
_KF_RATE_FRACTION = const(1)
_KF_BIAS = const(2)
_KF_BIAS_FRACTION = const(3)
_KF_GAIN_RATE = const(4)
_KF_GAIN_BIAS = const(5)

_N_AXES = const(3)
_ROW = const(6)
_HALF = const(1 << 9)
_LOW_10 = const((1 << 10) - 1)
_LOW_20 = const((1 << 20) - 1)
_RESIDUAL_LIMIT = const((1 << 20) - 1)
_BIAS_LIMIT = const(1 << 29)


def kalman_plain(values, at, last, state):
    """Filter values[at:last:6] into `state`; return the number of clipped values."""
    rate, rate_rest = state[_KF_RATE], state[_KF_RATE_FRACTION]
    bias, bias_rest = state[_KF_BIAS], state[_KF_BIAS_FRACTION]
    gain_rate, gain_bias = state[_KF_GAIN_RATE], state[_KF_GAIN_BIAS]
    clipped = 0
    while at < last:
        r = (values[at] << 4) - rate - ((bias + (rate_rest >> 10) + _HALF) >> 10)
        if r > _RESIDUAL_LIMIT:
            r = _RESIDUAL_LIMIT
            clipped += 1
        elif r < -_RESIDUAL_LIMIT:
            r = -_RESIDUAL_LIMIT
            clipped += 1
        # r times a gain has 40 bits: multiplied in two digits of r with explicit carry.
        high = r >> 10
        low = r & _LOW_10
        product = gain_rate * high
        rate_rest += gain_rate * low
        rate += (product >> 10) + (rate_rest >> 20)
        rate_rest = (rate_rest & _LOW_20) + ((product & _LOW_10) << 10)
        rate += rate_rest >> 20
        rate_rest &= _LOW_20
        product = gain_bias * high
        bias_rest += gain_bias * low
        bias += (product >> 10) + (bias_rest >> 20)
        bias_rest = (bias_rest & _LOW_20) + ((product & _LOW_10) << 10)
        bias += bias_rest >> 20
        bias_rest &= _LOW_20
        at += _ROW
    # One sample moves the bias by at most 2^20: clipping once per call keeps it below 2^30.
    if bias > _BIAS_LIMIT:
        bias = _BIAS_LIMIT
        clipped += 1
    elif bias < -_BIAS_LIMIT:
        bias = -_BIAS_LIMIT
        clipped += 1
    state[_KF_RATE] = rate
    state[_KF_RATE_FRACTION] = rate_rest
    state[_KF_BIAS] = bias
    state[_KF_BIAS_FRACTION] = bias_rest
    return clipped


try:
    from fast import kalman  # type: ignore[assignment]
except (ImportError, SyntaxError, ValueError, AttributeError, NameError):
    # This interpreter has no native code, or the file was compiled for another processor.
    kalman = kalman_plain


class KalmanFilter:
    """The two-state filter with constant gains, on three axes."""

    def __init__(self, gain_rate_q20, gain_bias_q30):
        self.saturations = 0
        self._axes = tuple(array("i", (0, 0, 0, 0, gain_rate_q20, gain_bias_q30)) for _ in range(_N_AXES))

    def reset(self, axis, bias_q14):
        """Reset an axis to rate zero with a bias, |bias| <= 2^28."""
        state = self._axes[axis]
        state[_KF_RATE] = state[_KF_RATE_FRACTION] = state[_KF_BIAS_FRACTION] = 0
        state[_KF_BIAS] = bias_q14

    def drift(self, axis, step_q18):
        """Add a step of the warm-up to the bias state, |step_q18| < 2^27."""
        state = self._axes[axis]
        fraction = state[_KF_BIAS_FRACTION] + ((step_q18 & 15) << 16)
        state[_KF_BIAS] += (step_q18 >> 4) + (fraction >> 20)
        state[_KF_BIAS_FRACTION] = fraction & _LOW_20

    def update(self, values, first, count):
        """Filter `count` <= 255 samples, rows of six int16 from values[first], gyro first."""
        last = first + _ROW * count
        for axis in range(_N_AXES):
            clipped = kalman(values, first + axis, last, self._axes[axis])  # type: ignore[arg-type]
            if clipped:
                self.saturations = (self.saturations + clipped) & 0xFFFF

    def rate_q8(self, axis):
        """Return the angular rate, 1/256 gyro step. Only its sum with the bias is observable."""
        state = self._axes[axis]
        return (state[_KF_RATE] << 4) + (state[_KF_RATE_FRACTION] >> 16)

    def bias_q12(self, axis):
        """Return the bias, 1/4096 gyro step. Only its sum with the rate is observable."""
        return self._axes[axis][_KF_BIAS] >> 2
