"""Rate of three gyro axes by recursive least squares with forgetting: Shah et al., eq. 13-14.

Per axis, with y the sample minus the bias, regressors x_n = [n, yhat_(n-1) - y_n] and weights
lambda^(N - n). In the printed form P_11 falls as n^-2 and P_22 spans twelve decades, too wide for fixed
point. The same filter, algebraically identical, in quantities of limited range:
- the level L = n b_1 replaces b_1: it grows by n / (n - 1) per sample, and its regressor is 1;
- the regressors are processed in turn (Gram-Schmidt recursion in a priori errors): each needs only a
  scalar energy, and all gains are between 0 and 1:
    E_1 = 1 + lambda ((n - 1) / n)^2 E_1,   g = 1 / E_1,   a = 1 - g
    e = yhat - y - M,  M += g e             (residual of the second regressor on the first)
    h = y - L,         L += g h             (residual of the sample on the first)
    z = h - b_2 e,     E = lambda E_2 + a e^2,   b_2 += a e z / E
    yhat = y - a (lambda E_2 / E) z,        E_2 = E, but at least 2^-10
E_1 and g are common to the axes and independent of the data. Without excitation E_2 falls to its bound, as
P_22 is bounded in the float filter, so there is no wind-up.

Number formats: y, yhat, L, M, e, h, z Q8 gyro steps, L and M with 20 more bits so that no rounding enters
their sums; E_1 Q18; g Q25; b_2 Q24, |b_2| <= 16; E and its products small floats. n stops at 2^20, 84
minutes at 208 Hz; up to there the level leads the gyro by 1 / ((1 - lambda) n) of itself, as a line through
n = 0 does.

Only the sum of rate and bias is observable: the bias stays at its initial value, except for the warm-up.
"""

from array import array

from micropython import const
from small_float import ONE, integer, number, over, plus, times

_N_AXES = const(3)
_ROW = const(6)
_LAST_N = const(1 << 20)
_GAIN_ONE = const(1 << 25)
_LOW_13 = const((1 << 13) - 1)
_LOW_10 = const((1 << 10) - 1)
_LOW_20 = const((1 << 20) - 1)
_LIMIT = const(1 << 26)
"""Bound on h, e and rate: 2^18 steps."""

# Indices into the state of one axis, an array of int32.
_LEVEL_AT = const(0)
_M = const(2)  # L, at _LEVEL_AT, and M are each followed by their fraction
_B = const(4)
_E = const(5)
_RATE_AT = const(6)
_BIAS_AT = const(7)  # Q14, followed by its fraction of four bits
_STATE_WORDS = const(9)
_B_LIMIT = const(1 << 28)
_START_ENERGY = ONE
_LEAST_ENERGY = const((1 << 18) << 8 | (128 - 28))  # the small float 2^-10


class RlsFilter:
    """The filter on three axes. forgetting_q20: lambda 2^20, 2^19 to 2^20 - 1024."""

    def __init__(self, forgetting_q20):
        self.saturations = 0
        self._forget = (1 << 20) - forgetting_q20
        self._lambda = number(forgetting_q20, -20)
        self._axes = tuple(array("i", bytes(4 * _STATE_WORDS)) for _ in range(_N_AXES))
        self._n = self._energy = 0

    def reset(self, axis, bias_q14):
        """Reset an axis to rate zero with a bias, |bias| <= 2^28; resets E_1 and n of all axes."""
        state = self._axes[axis]
        for i in range(_STATE_WORDS):
            state[i] = 0
        state[_E] = _START_ENERGY
        state[_BIAS_AT] = bias_q14
        self._n = self._energy = 0

    def drift(self, axis, step_q18):
        """Add a step of the warm-up to the bias."""
        state = self._axes[axis]
        remainder = state[_BIAS_AT + 1] + step_q18
        state[_BIAS_AT] += remainder >> 4
        state[_BIAS_AT + 1] = remainder & 15

    def update(self, values, first, count):
        """Filter `count` samples, rows of six int16 from values[first], gyro first."""
        for at in range(first, first + _ROW * count, _ROW):
            gain = self._next()
            for axis in range(_N_AXES):
                self._update(self._axes[axis], values[at + axis], gain)

    def rate_q8(self, axis):
        """Return the angular rate, 1/256 gyro step. Only its sum with the bias is observable."""
        return self._axes[axis][_RATE_AT]

    def bias_q12(self, axis):
        """Return the bias, 1/4096 gyro step: the initial one plus the warm-up since."""
        return self._axes[axis][_BIAS_AT] >> 2

    def _next(self):
        """Update E_1 for the next sample; return its gain g, Q25."""
        energy = self._energy
        n = self._n
        if n < _LAST_N:
            self._n = n = n + 1
            energy -= energy // n
            energy -= energy // n
        # Product of 1 - lambda and E_1, each in two digits, so that no intermediate exceeds 2^30.
        high, low = energy >> 15, energy & 0x7FFF
        f, g = self._forget >> 10, self._forget & _LOW_10
        energy += (1 << 18) - (high * f << 5) - ((high * g >> 5) + (low * f >> 10))
        self._energy = energy
        # 2^43 / E_1 by long division; E_1 <= 2^28.
        quotient, remainder = (1 << 29) // energy, (1 << 29) % energy
        for _ in range(14):
            remainder <<= 1
            quotient <<= 1
            if remainder >= energy:
                remainder -= energy
                quotient += 1
        return quotient if quotient < _GAIN_ONE else _GAIN_ONE - 1

    def _update(self, state, sample, gain):
        before = self._n - 1
        if 0 < before < _LAST_N - 1:
            _grow(state, _LEVEL_AT, before)
            _grow(state, _M, before)
        y = (sample << 8) - (state[_BIAS_AT] + 32 >> 6)
        e = self._held(state[_RATE_AT] - y - state[_M])
        h = self._held(y - state[_LEVEL_AT])
        _learn(state, _LEVEL_AT, gain, h)
        _learn(state, _M, gain, e)
        size = number(e, -8)
        share = number(_GAIN_ONE - gain, -25)
        weight = times(share, size)
        past = times(self._lambda, state[_E])
        energy = plus(past, times(weight, size))
        z = self._held(h - _product(state[_B], e))
        left = number(z, -8)
        b = state[_B] + integer(times(over(weight, energy), left), 24)
        if not -_B_LIMIT <= b <= _B_LIMIT:
            b = _B_LIMIT if b > 0 else -_B_LIMIT
            self.saturations = self.saturations + 1 & 0xFFFF
        state[_B] = b
        state[_RATE_AT] = y - integer(times(times(share, over(past, energy)), left), 8)
        state[_E] = energy if energy > 0 and (energy & 255) > 100 else _LEAST_ENERGY

    def _held(self, value):
        if -_LIMIT <= value <= _LIMIT:
            return value
        self.saturations = self.saturations + 1 & 0xFFFF
        return _LIMIT if value > 0 else -_LIMIT


def _product(b, e):
    """Return b_2 e in Q8, clipped to +-2^28."""
    high, low = b >> 12, b & 0xFFF
    f, g = e >> 13, e & _LOW_13
    most = high * f
    if not -(1 << 27) < most < 1 << 27:
        return 1 << 28 if most > 0 else -(1 << 28)
    return (most << 1) + ((high * g >> 1) + low * f + (1 << 10) >> 11)


def _grow(state, at, before):
    """Multiply state[at] by n / (n - 1), to 2^-18 steps."""
    value = state[at]
    part = state[at + 1] + ((value % before << 10) // before << 10)
    state[at] = value + value // before + (part >> 20)
    state[at + 1] = part & _LOW_20


def _learn(state, at, gain, error):
    """Add gain times error to state[at], to 2^-28 steps: both factors in two digits."""
    f, g = gain >> 10, gain & _LOW_10
    high, low = error >> 13, error & _LOW_13
    one, two, three = f * high, f * low, g * high
    part = state[at + 1] + ((one & 3) << 18) + ((two & 0x7FFF) << 5) + ((three & 0xFFF) << 8) + (g * low >> 5)
    state[at] += (one >> 2) + (two >> 15) + (three >> 12) + (part >> 20)
    state[at + 1] = part & _LOW_20
