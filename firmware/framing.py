"""Framing without allocation: CRC-16 by table, COBS in place; decoding of requests.

A frame is built in the buffer that it is sent from: COBS code at raw[START], header (type, node, seq) at
raw[BODY:], payload at raw[PAYLOAD:], then CRC and a zero as delimiter.
"""

from micropython import const
from wire import CRC_INITIAL, CRC_SIZE, CRC_TABLE, HEADER_SIZE, MAX_FRAME

START = const(1)
BODY = const(2)
PAYLOAD = const(6)
SLOT_WORDS = const(126)
"""int16 in a slot: the largest frame after one unused byte, which aligns the payload to an even address."""

_ZERO = b"\0"


def crc16_plain(raw, start, end):
    """Return the CRC-16/CCITT-FALSE of raw[start:end]."""
    table = CRC_TABLE
    high, low = CRC_INITIAL >> 8, CRC_INITIAL & 0xFF
    for i in range(start, end):
        at = (high ^ raw[i]) << 1
        high = low ^ table[at + 1]
        low = table[at]
    return high << 8 | low


def seal_plain(raw, end):
    """Seal the frame with header and payload in raw[BODY:end]; it is then raw[START:result]."""
    crc = crc16_plain(raw, BODY, end)
    raw[end] = crc & 0xFF
    raw[end + 1] = crc >> 8
    end += CRC_SIZE
    at = START
    zero = raw.find(_ZERO, BODY, end)
    while zero >= 0:
        raw[at] = zero - at
        at = zero
        zero = raw.find(_ZERO, at + 1, end)
    raw[at] = end - at
    raw[end] = 0
    return end + 1


try:
    from fast import crc16, seal
except (ImportError, SyntaxError, ValueError, AttributeError, NameError):
    # This interpreter has no native code, or the file was compiled for another processor.
    crc16, seal = crc16_plain, seal_plain  # type: ignore[assignment]


class FrameReader:
    """Decodes frames from the host byte by byte; damaged ones are counted.

    Valid after `feed` returned True: `type_id`, `node`, `seq`, and the payload raw[PAYLOAD:PAYLOAD + size].
    """

    def __init__(self):
        self.raw = bytearray(START + MAX_FRAME)
        self.damaged = 0
        self.type_id = self.node = self.seq = self.size = 0
        self._end = START
        self._skipping = False

    def feed(self, byte):
        """Return True when `byte` completes an undamaged frame."""
        if byte:
            if self._end < START + MAX_FRAME - 1:
                self.raw[self._end] = byte
                self._end += 1
            else:
                self._skipping = True
            return False
        end, skipping = self._end, self._skipping
        self._end, self._skipping = START, False
        if skipping:
            self.damaged += 1
            return False
        if end == START:
            return False
        if not self._open(end):
            self.damaged += 1
            return False
        return True

    def _open(self, end):
        raw = self.raw
        at = START
        while at < end:
            step = raw[at]
            raw[at] = 0
            at += step
        size = end - PAYLOAD - CRC_SIZE
        if at != end or size < 0:
            return False
        crc = crc16(raw, BODY, end - CRC_SIZE)  # type: ignore[arg-type]
        if crc != raw[end - 2] | raw[end - 1] << 8:
            return False
        self.type_id = raw[BODY]
        self.node = raw[BODY + 1]
        self.seq = raw[BODY + 2] | raw[BODY + 3] << 8
        self.size = size
        return True


assert PAYLOAD == BODY + HEADER_SIZE
