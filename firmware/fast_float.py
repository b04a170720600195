"""Native versions of the operations of small_float.py; the import fails without native code."""

import micropython


@micropython.viper
def number(m: int, e: int) -> int:
    """Compute the same as small_float.number_plain, bit by bit."""
    if m == 0:
        return 0
    size: int = m
    if m < 0:
        size = 0 - m
    e += 128
    k: int = 0
    if size >= 0x80000:
        k = 1
        if size >= 0x1000000:
            k = 6
        while (size >> k) >= 0x80000:
            k += 1
        size = (size >> k) + ((size >> (k - 1)) & 1)
        e += k
    elif size < 0x40000:
        while size < 0x40000:
            size <<= 1
            k += 1
        e -= k
    if e < 0:
        return 0
    if e > 255:
        size = 0x7FFFF
        e = 255
    if m < 0:
        size = 0 - size
    return (size << 8) | e


@micropython.viper
def times(x: int, y: int) -> int:
    """Compute the same as small_float.times_plain, bit by bit."""
    b: int = y >> 8
    m: int = (x >> 17) * b + ((((x >> 8) & 511) * b) >> 9)
    if m == 0:
        return 0
    e: int = (x & 255) + (y & 255) - 110
    if m < 0x10000000 and m > -0x10000000:
        m = (m + 256) >> 9
    else:
        m = (m + 512) >> 10
        e += 1
    if e < 0:
        return 0
    if e > 255:
        if m > 0:
            m = 0x7FFFF
        else:
            m = -0x7FFFF
        e = 255
    return (m << 8) | e


@micropython.viper
def plus(x: int, y: int) -> int:
    """Compute the same as small_float.plus_plain, bit by bit."""
    if x == 0:
        return y
    if y == 0:
        return x
    e: int = x & 255
    k: int = e - (y & 255)
    if k < 0:
        other: int = x
        x = y
        y = other
        e -= k
        k = 0 - k
    if k > 20:
        return x
    m: int = ((x >> 8) << 5) + (((y >> 8) << 5) >> k)
    if m >= 0x800000 and m < 0x1000000:
        return (((m + 16) >> 5) << 8) | e
    return int(number(m, e - 133))


@micropython.viper
def over(x: int, y: int) -> int:
    """Compute the same as small_float.over_plain, bit by bit."""
    if x == 0:
        return 0
    a: int = x >> 8
    b: int = y >> 8
    negative: int = 0
    if a < 0:
        a = 0 - a
        negative = 1
    if b < 0:
        b = 0 - b
        negative = 1 - negative
    m: int = a << 10
    m = ((m // b) << 9) + ((m % b) << 9) // b
    e: int = (x & 255) - (y & 255) + 109
    if m >= 0x80000:
        m = (m + 1) >> 1
        e += 1
    if negative:
        m = 0 - m
    if e < 0 or e > 255:
        return int(number(m, e - 128))
    return (m << 8) | e


@micropython.viper
def integer(x: int, q: int) -> int:
    """Compute the same as small_float.integer_plain, bit by bit."""
    m: int = x >> 8
    shift: int = (x & 255) - 128 + q
    if shift <= 0:
        if shift < -20:
            return 0
        shift = 0 - shift
        return (m + ((1 << shift) >> 1)) >> shift
    if shift > 10:
        if m == 0:
            return 0
        if m > 0:
            return 0x20000000
        return -0x20000000
    return m << shift
