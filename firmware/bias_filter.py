"""Rate and bias of three gyro axes in integers: the steady-state Kalman filter of Shah et al., eq. 4-12.

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
    rate       Q4, and its rest Q24 in 0 .. 2^20 - 1
    bias       Q14, and its rest Q34 in 0 .. 2^20 - 1, clipped to +-2^29
The rests make both sums exact: no rounding error ever enters them. Only r is rounded, to 1/16 step. Rate
and bias take the same r, so its roundings e act on their sum s as s += g lambda (z - s - e), which forgets
them: s is off by at most 1/32 step (and 2^-14 from the rest cut off), bias by k2 / lambda and rate by
k1 / lambda of that, for ever. Every intermediate is within +-2^30.

Rate and bias are seen only through their sum: the observability matrix has rank 1. `rate + bias` follows the
gyro; how it is split rests on the bias at the start (`StaticInit`) and on the ratio k2 : k1.
"""

from array import array

from micropython import const
from wire import (
    FILTER_KIND_KALMAN,
    FILTER_KIND_OFF,
    FILTER_KIND_RLS,
    FILTER_STATE_INITIALISING,
    FILTER_STATE_TRACKING,
    FILTER_STATE_WAITING,
)

GAIN_LIMIT = const(1 << 20)
"""Both gains are below this."""

# State of one axis, array of int32.
_RATE = const(0)
_RATE_REST = const(1)
_BIAS = const(2)
_BIAS_REST = const(3)
_GAIN_RATE = const(4)
_GAIN_BIAS = const(5)

_AXES = const(3)
_ROW = const(6)
_HALF = const(1 << 9)
_LOW_10 = const((1 << 10) - 1)
_LOW_20 = const((1 << 20) - 1)
_RESIDUAL_LIMIT = const((1 << 20) - 1)
_BIAS_LIMIT = const(1 << 29)


def kalman_plain(values, at, last, state):
    """Filters values[at:last:6] into `state`; returns how often it clipped."""
    rate, rate_rest = state[_RATE], state[_RATE_REST]
    bias, bias_rest = state[_BIAS], state[_BIAS_REST]
    gain_rate, gain_bias = state[_GAIN_RATE], state[_GAIN_BIAS]
    clipped = 0
    while at < last:
        r = (values[at] << 4) - rate - ((bias + (rate_rest >> 10) + _HALF) >> 10)
        if r > _RESIDUAL_LIMIT:
            r = _RESIDUAL_LIMIT
            clipped += 1
        elif r < -_RESIDUAL_LIMIT:
            r = -_RESIDUAL_LIMIT
            clipped += 1
        # r times a gain is 2^40: in two digits of r, carried by hand.
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
    state[_RATE] = rate
    state[_RATE_REST] = rate_rest
    state[_BIAS] = bias
    state[_BIAS_REST] = bias_rest
    return clipped


try:
    from fast import kalman  # type: ignore[assignment]
except (ImportError, SyntaxError, ValueError, AttributeError, NameError):
    # This interpreter has no native code, or the file was compiled for another processor.
    kalman = kalman_plain


class KalmanFilter:
    """The two-state filter with constant gains, three axes side by side."""

    def __init__(self, gain_rate_q20, gain_bias_q30):
        self.saturations = 0
        self._axes = tuple(array("i", (0, 0, 0, 0, gain_rate_q20, gain_bias_q30)) for _ in range(_AXES))

    def begin(self, axis, bias_q14):
        """Sets an axis at rest with a bias, |bias| <= 2^28."""
        state = self._axes[axis]
        state[_RATE] = state[_RATE_REST] = state[_BIAS_REST] = 0
        state[_BIAS] = bias_q14

    def update(self, values, first, count):
        """Takes `count` <= 255 samples, rows of six int16 from values[first], gyro in front."""
        last = first + _ROW * count
        for axis in range(_AXES):
            clipped = kalman(values, first + axis, last, self._axes[axis])  # type: ignore[arg-type]
            if clipped:
                self.saturations = (self.saturations + clipped) & 0xFFFF

    def rate_q8(self, axis):
        """Angular rate, 1/256 gyro step. Only its sum with the bias is observable; see the module."""
        state = self._axes[axis]
        return (state[_RATE] << 4) + (state[_RATE_REST] >> 16)

    def bias_q12(self, axis):
        """Bias, 1/4096 gyro step. Only its sum with the rate is observable; see the module."""
        return self._axes[axis][_BIAS] >> 2


class RlsFilter(KalmanFilter):
    """Recursive least squares with a forgetting factor, Shah et al. eq. 13-14, for a rate that stands still.

    With the regressor 1, eq. 14 is P' = P / (lambda + P), and P' is also the gain of eq. 13: it falls from 1
    to 1 - lambda by itself. The bias stays where `begin` put it: this filter has no state for it.

    gain_rate_q20 is (1 - lambda) 2^20: 20972 for 0.98, 83886 for 0.92. P is Q20 like it and rounded, so it
    stops falling up to 2^-20 (2 + 1 / (2 (1 - lambda))) above its end, and is set there: 27 / 2^20 for 0.98.
    """

    def __init__(self, gain_rate_q20, gain_bias_q30):
        self._final = gain_rate_q20
        self._gain = GAIN_LIMIT - 1
        super().__init__(gain_rate_q20, 0)

    def begin(self, axis, bias_q14):
        """Sets an axis at rest with a bias, |bias| <= 2^28; all axes forget what they have seen."""
        super().begin(axis, bias_q14)
        self._gain = GAIN_LIMIT - 1

    def update(self, values, first, count):
        """Takes `count` <= 255 samples, rows of six int16 from values[first], gyro in front."""
        while count and self._gain != self._final:
            self._set_gain(self._gain)
            super().update(values, first, 1)
            first += _ROW
            count -= 1
            self._gain = next_gain(self._gain, self._final)
            if self._gain == self._final:
                self._set_gain(self._gain)
        if count:
            super().update(values, first, count)

    def _set_gain(self, gain):
        for axis in range(_AXES):
            self._axes[axis][_GAIN_RATE] = gain


def next_gain(gain, final):
    """P / (lambda + P) in Q20, P = gain, lambda = 2^20 - final; `final` once it falls no more."""
    divisor = GAIN_LIMIT - final + gain
    # 21 bits of quotient, the last to round by, as many at a time as keep the rest small.
    rest = gain << 9
    quotient = rest // divisor
    rest = rest % divisor << 9
    quotient = (quotient << 9) + rest // divisor
    rest = rest % divisor << 3
    quotient = (quotient << 3) + rest // divisor + 1 >> 1
    return quotient if final < quotient < gain else final


LEAST_SAMPLES = const(2000)
"""Behind a static initialisation."""

ESTIMATORS = ((FILTER_KIND_KALMAN, KalmanFilter), (FILTER_KIND_RLS, RlsFilter))
"""(FilterKind, class with `begin`, `update`, `rate_q8`, `bias_q12`, `saturations`)."""


KINDS = (FILTER_KIND_OFF,) + tuple(row[0] for row in ESTIMATORS)
"""What FILTER_KIND may be."""


def estimator(kind, gain_rate_q20, gain_bias_q30):
    """A new estimator of that FilterKind, or None where there is none."""
    for known, make in ESTIMATORS:
        if known == kind:
            return make(gain_rate_q20, gain_bias_q30)
    return None


class StaticInit:
    """Bias and variance of a wheel at rest, from plain sums over at least 2000 samples.

    A wheel that turns is refused: by a gyro mean or sample beyond what a bias can be (30 deg/s), by gyro
    variance above (1 deg/s)^2, or by gravity moving in the node (accelerometer variance above (0.02 g)^2).
    """

    def __init__(self):
        self.state = FILTER_STATE_WAITING
        self.samples = 0
        """Behind the last finished initialisation."""
        self.bias_q14 = [0] * _AXES
        self.variance_q8 = [0] * _AXES
        self.turning = False
        self._reference = [0] * _ROW
        self._sum = [0] * _ROW
        self._square_high = [0] * _ROW
        self._square_low = [0] * _ROW
        self._limit = [0] * _ROW
        self._variance_limit = [0] * _ROW
        self._wanted = self._seen = 0
        self._before = FILTER_STATE_WAITING
        self._bias_q14 = [0] * _AXES
        self._variance_q8 = [0] * _AXES

    def begin(self, samples, gyro_lsb_ndps, accel_lsb_ng):
        """Starts over with LEAST_SAMPLES <= samples <= 65535."""
        for i in range(_ROW):
            self._sum[i] = self._square_high[i] = self._square_low[i] = 0
            if i < _AXES:
                self._limit[i] = 1000000000 // gyro_lsb_ndps * 30
                self._variance_limit[i] = (1000000000 // gyro_lsb_ndps) ** 2
            else:
                self._limit[i] = 500000000 // accel_lsb_ng
                self._variance_limit[i] = (20000000 // accel_lsb_ng) ** 2
        self._wanted, self._seen = samples, 0
        self.turning = False
        if self.state != FILTER_STATE_INITIALISING:
            self._before = self.state
        self.state = FILTER_STATE_INITIALISING

    def update(self, values, first, count):
        """Takes rows of six int16; True when it has ended: in TRACKING, or as before with `turning`."""
        for at in range(first, first + _ROW * count, _ROW):
            if self._seen == 0:
                for i in range(_ROW):
                    self._reference[i] = values[at + i]
            for i in range(_ROW):
                d = values[at + i] - self._reference[i]
                if d > self._limit[i] or d < -self._limit[i]:
                    self.turning = True
                    self.state = self._before
                    return True
                self._sum[i] += d
                square = self._square_low[i] + d * d
                self._square_high[i] += square >> 20
                self._square_low[i] = square & _LOW_20
            self._seen += 1
            if self._seen == self._wanted:
                self._finish()
                return True
        return False

    def _finish(self):
        n = self._wanted
        for i in range(_ROW):
            mean, part = self._sum[i] // n, self._sum[i] % n
            # Mean square by long division of the double word, ten bits at a time, then eight more.
            high, rest = self._square_high[i] // n, self._square_high[i] % n
            rest = (rest << 10) + (self._square_low[i] >> 10)
            middle, rest = rest // n, rest % n
            rest = (rest << 10) + (self._square_low[i] & _LOW_10)
            low, rest = rest // n, rest % n
            variance = (high << 20) + (middle << 10) + low - mean * mean
            if variance > self._variance_limit[i]:
                self.turning = True
            elif i < _AXES:
                part_q8 = (part << 8) // n
                variance = (variance << 8) + (rest << 8) // n - 2 * mean * part_q8 - (part_q8 * part_q8 >> 8)
                if not -self._limit[i] <= self._reference[i] + mean <= self._limit[i]:
                    self.turning = True
                else:
                    self._variance_q8[i] = variance if variance > 0 else 0
                    self._bias_q14[i] = ((self._reference[i] + mean) << 14) + (part << 14) // n
        if self.turning:
            self.state = self._before
            return
        self.samples = n
        self.state = FILTER_STATE_TRACKING
        for i in range(_AXES):
            self.bias_q14[i], self.variance_q8[i] = self._bias_q14[i], self._variance_q8[i]
