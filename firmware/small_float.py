"""Floating point in small integers, for quantities of wide range in code that must not allocate.

x = m << 8 | e stands for m 2^(e - 128), with 2^18 <= |m| <= 2^19; zero is 0. So 2^-110 to 2^146 with 19 bits:
each operation rounds to 2^-18 of its result or better; smaller results become zero, larger ones saturate.
Every intermediate is within +-2^30. MicroPython's own floats are allocated on the heap.
"""

from micropython import const

_EXPONENT_BIAS = const(128)
_MIN_MANTISSA = const(1 << 18)
_END_MANTISSA = const(1 << 19)
_MAX_VALUE = const(((1 << 19) - 1) << 8 | 255)
INTEGER_LIMIT = const(1 << 29)
"""Largest magnitude that `integer` returns."""


def number_plain(m, e):
    """Return m 2^e as a small float, for |m| < 2^30."""
    if not m:
        return 0
    size = m if m > 0 else -m
    e += _EXPONENT_BIAS
    if size >= _END_MANTISSA:
        k = 6 if size >= 1 << 24 else 1
        while size >> k >= _END_MANTISSA:
            k += 1
        size = (size >> k) + (size >> k - 1 & 1)
        e += k
    elif size < _MIN_MANTISSA:
        k = 0
        if size < 1 << 9:
            size <<= 9
            k = 9
        if size < 1 << 14:
            size <<= 5
            k += 5
        while size < _MIN_MANTISSA:
            size <<= 1
            k += 1
        e -= k
    if e < 0:
        return 0
    if e > 255:
        return _MAX_VALUE if m > 0 else -_MAX_VALUE + 510
    return (size if m > 0 else -size) << 8 | e


def integer_plain(x, q):
    """Return x 2^q as an integer, rounded, clipped to +-INTEGER_LIMIT."""
    m = x >> 8
    shift = (x & 255) - _EXPONENT_BIAS + q
    if shift <= 0:
        return 0 if shift < -20 else (m + (1 << -shift >> 1)) >> -shift
    if shift > 10:
        return 0 if not m else INTEGER_LIMIT if m > 0 else -INTEGER_LIMIT
    return m << shift


def times_plain(x, y):
    """Return x y."""
    b = y >> 8
    m = (x >> 17) * b + ((x >> 8 & 511) * b >> 9)
    if not m:
        return 0
    e = (x & 255) + (y & 255) - (_EXPONENT_BIAS - 18)
    if -(1 << 28) < m < 1 << 28:
        m = m + 256 >> 9
    else:
        m = m + 512 >> 10
        e += 1
    if e < 0:
        return 0
    if e > 255:
        return _MAX_VALUE if m > 0 else -_MAX_VALUE + 510
    return m << 8 | e


def plus_plain(x, y):
    """Return x + y."""
    if not x:
        return y
    if not y:
        return x
    e = x & 255
    k = e - (y & 255)
    if k < 0:
        x, y, k = y, x, -k
        e += k
    if k > 20:
        return x
    m = ((x >> 8) << 5) + ((y >> 8) << 5 >> k)
    if m >= 1 << 23 and m < 1 << 24:
        return m + 16 >> 5 << 8 | e
    return number(m, e - (_EXPONENT_BIAS + 5))


def minus(x):
    """Return -x."""
    return -(x >> 8) << 8 | x & 255 if x else 0


def over_plain(x, y):
    """Return x / y; y must not be zero."""
    if not x:
        return 0
    a, b = x >> 8, y >> 8
    positive = (a > 0) == (b > 0)
    a = a if a > 0 else -a
    b = b if b > 0 else -b
    m = a << 10
    m = (m // b << 9) + (m % b << 9) // b
    e = (x & 255) - (y & 255) + (_EXPONENT_BIAS - 19)
    if m >= _END_MANTISSA:
        m = m + 1 >> 1
        e += 1
    if not 0 <= e <= 255:
        return number(m if positive else -m, e - _EXPONENT_BIAS)
    return (m if positive else -m) << 8 | e


def root(x):
    """Return the square root of x >= 0."""
    if x <= 0:
        return 0
    m, e = x >> 8, (x & 255) - _EXPONENT_BIAS
    # An even exponent, and as many bits of mantissa as fit.
    shift = 9 if e & 1 else 10
    m <<= shift
    e -= shift
    guess = 1 << 15
    while True:
        better = guess + m // guess >> 1
        if better >= guess:
            break
        guess = better
    # One more Newton step for the fraction: 15 bits of the root, then 15 more.
    remainder = m - guess * guess
    return number(
        (guess << 14) + (remainder << 13) // guess if remainder < 1 << 16 else guess << 14, (e >> 1) - 14
    )


try:
    from fast_float import integer, number, over, plus, times  # type: ignore[assignment]
except (ImportError, SyntaxError, ValueError, AttributeError, NameError):
    # This interpreter has no native code, or the file was compiled for another processor.
    number, integer = number_plain, integer_plain
    times, plus, over = times_plain, plus_plain, over_plain

ONE = const(_MIN_MANTISSA << 8 | (_EXPONENT_BIAS - 18))
