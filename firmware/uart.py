"""Links over a UART, its own or an ESP32's console: what is written at once is what its buffer has room for.

A port holds a write up until all of it is in the send buffer, and only some say beforehand whether it fits:
an ESP32 never does. So the room is known by the clock.
"""

from time import ticks_add, ticks_diff, ticks_us

from link import Link, UsbLink, _write
from micropython import const
from wire import CONSOLE_BAUD

_CHUNK = const(64)
_CONSOLE_FIFO = const(128)


class Pace:
    """How many of `size` bytes of a send buffer are free, when what was written leaves it at `baud`."""

    def __init__(self, baud, size):
        # Ten bits a byte, and two percent for a UART whose clock is slow; in hundreds, as small integers.
        self._byte_ns = 102000000 // (baud // 100)
        self._size = size
        self._full_us = size * self._byte_ns // 1000
        self._empty_us = ticks_us()

    def room(self):
        """Free bytes now."""
        now = ticks_us()
        left_us = ticks_diff(self._empty_us, now)
        if left_us <= 0 or left_us > self._full_us:
            self._empty_us = now
            return self._size
        return self._size - left_us * 1000 // self._byte_ns - 1

    def wrote(self, count):
        """So many bytes were written; `room` has been asked before."""
        self._empty_us = ticks_add(self._empty_us, count * self._byte_ns // 1000 + 1)


class UartLink(Link):
    """A UART that was opened with timeout=0 and a send buffer of `size` bytes.

    Half of it is used: an ESP32 keeps up to 28 bytes of its own beside each write.
    """

    def __init__(self, uart, baud, size):
        super().__init__()
        self.MOST = _CHUNK
        self._uart = uart
        self._one = bytearray(1)
        self._pace = Pace(baud, size // 2)

    def _take(self, raw, at, size):
        if self._pace.room() < size:
            return 0
        taken = _write(self._uart, raw, at, size)
        if taken:
            self._pace.wrote(taken)
        return taken

    def _byte(self):
        if self._uart.any() and self._uart.readinto(self._one):
            return self._one[0]
        return -1


class ConsoleLink(UsbLink):
    """The console of an ESP32: a UART, whatever USB socket is before it or beside it."""

    CHUNK = _CHUNK

    def __init__(self):
        super().__init__()
        self._pace = Pace(CONSOLE_BAUD, _CONSOLE_FIFO)

    def _take(self, raw, at, size):
        if self._pace.room() < size:
            return 0
        taken = UsbLink._take(self, raw, at, size)
        if taken:
            self._pace.wrote(taken)
        return taken
