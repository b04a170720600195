"""Native twins of inner loops, byte for byte; importing fails where a port has no native code."""

from array import array

import micropython
from wire import CRC_POLYNOMIAL


def _crc_table():
    table = array("H", bytes(512))
    for i in range(256):
        crc = i << 8
        for _ in range(8):
            crc = (crc << 1) ^ CRC_POLYNOMIAL if crc & 0x8000 else crc << 1
        table[i] = crc & 0xFFFF
    return table


_TABLE = _crc_table()


@micropython.viper
def crc16(raw: ptr8, start: int, end: int) -> int:  # type: ignore[name-defined] # noqa: F821
    """CRC-16/CCITT-FALSE of raw[start:end]."""
    table = ptr16(_TABLE)  # type: ignore[name-defined] # noqa: F821
    crc: int = 0xFFFF
    i: int = start
    while i < end:
        crc = ((crc << 8) & 0xFF00) ^ table[(crc >> 8) ^ raw[i]]
        i += 1
    return crc


@micropython.viper
def kalman(values: ptr16, at: int, last: int, state: ptr32) -> int:  # type: ignore[name-defined] # noqa: F821
    """What bias_filter.kalman_plain does, to the same bits."""
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
