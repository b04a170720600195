"""Native versions of inner loops; the import fails where a port has no native code."""

from array import array

import micropython
from wire import CRC_TABLE

_TABLE = array("H", CRC_TABLE)


@micropython.viper
def crc16(raw: ptr8, start: int, end: int) -> int:  # type: ignore[name-defined] # noqa: F821
    """Compute the same as framing.crc16_plain."""
    table = ptr16(_TABLE)  # type: ignore[name-defined] # noqa: F821
    crc: int = 0xFFFF
    i: int = start
    while i < end:
        crc = ((crc << 8) & 0xFF00) ^ table[(crc >> 8) ^ raw[i]]
        i += 1
    return crc


@micropython.viper
def seal(raw: ptr8, end: int) -> int:  # type: ignore[name-defined] # noqa: F821
    """Compute the same as framing.seal_plain, CRC and COBS in one pass over the frame."""
    table = ptr16(_TABLE)  # type: ignore[name-defined] # noqa: F821
    crc: int = 0xFFFF
    # framing.START, then framing.BODY.
    at: int = 1
    i: int = 2
    byte: int = 0
    while i < end:
        byte = raw[i]
        crc = ((crc << 8) & 0xFF00) ^ table[(crc >> 8) ^ byte]
        if byte == 0:
            raw[at] = i - at
            at = i
        i += 1
    raw[end] = crc & 0xFF
    raw[end + 1] = crc >> 8
    end += 2
    while i < end:
        if raw[i] == 0:
            raw[at] = i - at
            at = i
        i += 1
    raw[at] = end - at
    raw[end] = 0
    return end + 1


@micropython.viper
def saturated(values: ptr16, at: int, last: int) -> int:  # type: ignore[name-defined] # noqa: F821
    """Compute the same as sampler.saturated_plain."""
    value: int = 0
    while at < last:
        value = int(values[at])
        if value == 0x7FFF or value == 0x8000:
            return 1
        at += 1
    return 0


@micropython.viper
def kalman(values: ptr16, at: int, last: int, state: ptr32) -> int:  # type: ignore[name-defined] # noqa: F821
    """Compute the same as bias_filter.kalman_plain, bit by bit."""
    rate: int = state[0]
    rate_rest: int = state[1]
    bias: int = state[2]
    bias_rest: int = state[3]
    gain_rate: int = state[4]
    gain_bias: int = state[5]
    clipped: int = 0
    while at < last:
        z: int = int(values[at])
        if z >= 0x8000:
            z -= 0x10000
        r: int = (z << 4) - rate - ((bias + (rate_rest >> 10) + 0x200) >> 10)
        if r > 0xFFFFF:
            r = 0xFFFFF
            clipped += 1
        elif r < -0xFFFFF:
            r = -0xFFFFF
            clipped += 1
        high: int = r >> 10
        low: int = r & 0x3FF
        product: int = gain_rate * high
        rate_rest += gain_rate * low
        rate += (product >> 10) + (rate_rest >> 20)
        rate_rest = (rate_rest & 0xFFFFF) + ((product & 0x3FF) << 10)
        rate += rate_rest >> 20
        rate_rest &= 0xFFFFF
        product = gain_bias * high
        bias_rest += gain_bias * low
        bias += (product >> 10) + (bias_rest >> 20)
        bias_rest = (bias_rest & 0xFFFFF) + ((product & 0x3FF) << 10)
        bias += bias_rest >> 20
        bias_rest &= 0xFFFFF
        at += 6
    if bias > 0x20000000:
        bias = 0x20000000
        clipped += 1
    elif bias < -0x20000000:
        bias = -0x20000000
        clipped += 1
    state[0] = rate
    state[1] = rate_rest
    state[2] = bias
    state[3] = bias_rest
    return clipped
