"""Bias from the known magnitude of the angular rate: scalar pseudo-measurement of Shah et al., eq. 1-3.

The samples are averaged over intervals; G is such a mean, b the bias, S = s^2 I the covariance of G, |w| the
known magnitude and c^2 its variance. With d = G - b and P the covariance of b, the corrected filter of
sensors/filters/pseudo_measurement.py (which shows why eq. 3 fails at standstill), halved on both sides:
    H = d'                                          eq. 2
    y = (|d|^2 - |w|^2 - tr S + tr P + c^2) / 2
    R = |w|^2 (s^2 + c^2) + (14 s^4 + 2 c^4 + 2 tr P^2) / 4        eq. 3, which has 4 d' S d + 2 tr S^2
    b += P d y / (d' P d + R)
The paper has d' S d in place of |w|^2 s^2. One s for all axes; the float version takes any covariance S.

P is factored as U D U' (Bierman: U unit upper triangular), which rounding cannot make indefinite, in small
floats, as P ranges from tens of steps squared to 1e-4. |d|^2 - |w|^2, a small difference of large numbers, is
exact: d and |w| in Q12 gyro steps, their squares in digits of 14 bits. b is Q16, |b| <= 2^13 steps.

Observable is b along G - b: all of it at standstill, the part along the axle on a spinning wheel. The other
parts stay at their initial value and sigma (`sigma_q12`).
"""

from micropython import const
from small_float import ONE, integer, minus, number, over, plus, times

_LOW_14 = const((1 << 14) - 1)
_LOW_15 = const((1 << 15) - 1)
_LIMIT_Q16 = const((1 << 29) - 1)
_ONE_HALF = const((1 << 18) << 8 | (128 - 19))
_QUARTER = const((1 << 18) << 8 | (128 - 20))
_TWO = const((1 << 18) << 8 | (128 - 17))


def mean_q14(high, low, divisor):
    """Return (high 2^15 + low) 2^14 / divisor by long division, for divisors below 2^24."""
    high += low >> 15
    low &= _LOW_15
    quotient, remainder = high // divisor, high % divisor
    # 15 bits of the low digit, then 14 bits of fraction.
    for shift in (9, 3):
        remainder = (remainder << 6) + (low >> shift & 63)
        quotient = (quotient << 6) + remainder // divisor
        remainder %= divisor
    remainder = (remainder << 3) + (low & 7)
    quotient = (quotient << 3) + remainder // divisor
    remainder = remainder % divisor << 6
    quotient = (quotient << 6) + remainder // divisor
    remainder = remainder % divisor << 6
    quotient = (quotient << 6) + remainder // divisor
    return (quotient << 2) + (remainder % divisor << 2) // divisor


def difference(d, rate_q12):
    """Return |d|^2 - |w|^2, steps^2, as a small float. d: (3,), rate_q12 < 2^28, Q12 steps."""
    high, low = rate_q12 >> 14, rate_q12 & _LOW_14
    top, middle, bottom = -high * high, -high * low, -low * low
    for axis in range(3):
        value = d[axis] if d[axis] >= 0 else -d[axis]
        high, low = value >> 14, value & _LOW_14
        top += high * high
        middle += high * low
        bottom += low * low
    # top 2^28 + middle 2^15 + bottom, in units of 2^-24; their sum may be much smaller than each of them.
    high = top + (middle >> 13)
    if not -(1 << 15) < high < 1 << 15:
        return number(high, 4)
    middle += top << 13
    high = middle + (bottom >> 15)
    if -(1 << 13) < high < 1 << 13:
        return number((middle << 15) + bottom, -24)
    return number(high, -9)


class PseudoFilter:
    """The filter in integers; one call of `update` per interval."""

    def __init__(self):
        self.bias_q16 = [0, 0, 0]
        self._d = [0, 0, 0]
        self._noise = self._fourth = self.surprise = 0
        """surprise: sum of the normalised squared innovations, about one per interval; small floats."""
        self._u12 = self._u13 = self._u23 = 0
        self._d1 = self._d2 = self._d3 = ONE

    def reset(self, variance, noise):
        """Reset the filter; variance of the bias and noise of a mean (s^2): steps^2, small floats."""
        self._u12 = self._u13 = self._u23 = 0
        self._d1 = self._d2 = self._d3 = variance
        self._noise = noise
        self.surprise = 0
        self._fourth = times(number(14, 0), times(noise, noise))

    def update(self, mean_q14, rate_q14, doubt):
        """Update with means (3,) and magnitude of the true rate, Q14 steps; doubt: variance of the latter."""
        d, b = self._d, self.bias_q16
        for axis in range(3):
            d[axis] = mean_q14[axis] - (b[axis] + 2 >> 2) + 2 >> 2
        h1, h2, h3 = number(d[0], -12), number(d[1], -12), number(d[2], -12)
        # More than three at once would allocate a tuple.
        u12, u13, u23 = self._u12, self._u13, self._u23
        d1, d2, d3 = self._d1, self._d2, self._d3
        # The elements of P, for tr P and tr P^2.
        p12, p13, p23 = times(u12, d2), times(u13, d3), times(u23, d3)
        p11 = plus(d1, plus(times(u12, p12), times(u13, p13)))
        p22 = plus(d2, times(u23, p23))
        p12 = plus(p12, times(u13, p23))
        r = plus(plus(times(p11, p11), times(p22, p22)), times(d3, d3))
        other = plus(plus(times(p12, p12), times(p13, p13)), times(p23, p23))
        r = times(_TWO, plus(plus(r, times(_TWO, other)), times(doubt, doubt)))
        r = times(_QUARTER, plus(r, self._fourth))
        rate = number(rate_q14, -14)
        r = plus(r, times(times(rate, rate), plus(self._noise, doubt)))
        y = plus(plus(p11, plus(p22, d3)), minus(times(number(3, 0), self._noise)))
        y = times(_ONE_HALF, plus(difference(d, rate_q14 + 2 >> 2), plus(y, doubt)))
        # Measurement update by Bierman.
        f2 = plus(times(u12, h1), h2)
        f3 = plus(plus(times(u13, h1), times(u23, h2)), h3)
        k1, k2, k3 = times(d1, h1), times(d2, f2), times(d3, f3)
        a1 = plus(r, times(k1, h1))
        a2 = plus(a1, times(k2, f2))
        a3 = plus(a2, times(k3, f3))
        self._d1 = times(d1, over(r, a1))
        self._d2 = times(d2, over(a1, a2))
        self._d3 = times(d3, over(a2, a3))
        part = minus(over(f2, a1))
        self._u12 = plus(u12, times(k1, part))
        k1 = plus(k1, times(u12, k2))
        part = minus(over(f3, a2))
        self._u13 = plus(u13, times(k1, part))
        self._u23 = plus(u23, times(k2, part))
        k1 = plus(k1, times(u13, k3))
        k2 = plus(k2, times(u23, k3))
        part = over(y, a3)
        self.surprise = plus(self.surprise, times(y, part))
        y = part
        self._move(0, times(k1, y))
        self._move(1, times(k2, y))
        self._move(2, times(k3, y))

    def variance(self, axis):
        """Return the variance of the bias of an axis, steps^2, as a small float."""
        if axis == 2:
            return self._d3
        p = times(times(self._u23, self._u23), self._d3)
        if axis == 1:
            return plus(self._d2, p)
        p = times(times(self._u12, self._u12), self._d2)
        return plus(self._d1, plus(p, times(times(self._u13, self._u13), self._d3)))

    def set_bias(self, axis, value):
        """Set the bias of an axis, Q16, clipped to +-2^13 steps."""
        if value > _LIMIT_Q16:
            value = _LIMIT_Q16
        elif value < -_LIMIT_Q16:
            value = -_LIMIT_Q16
        self.bias_q16[axis] = value

    def _move(self, axis, step):
        self.set_bias(axis, self.bias_q16[axis] + integer(step, 16))
