"""Links over a UART or the console of an ESP32; a write never exceeds the free space of the send buffer.

A port blocks a write until all of it is in the send buffer, and an ESP32 does not report the free space: it
is computed from the time that has passed.
"""

from time import sleep_ms, ticks_add, ticks_diff, ticks_us

import machine
from link import Link, UsbLink, _write
from micropython import const
from wire import CONSOLE_BAUD

_CHUNK = const(64)
_CONSOLE_FIFO = const(128)


class Pace:
    """Free space of a send buffer of `size` bytes that empties at `baud`."""

    def __init__(self, baud, size):
        # Ten bits per byte, 2 % for a slow clock of the UART; divided by 100 to stay within small integers.
        self._byte_ns = 102000000 // (baud // 100)
        self._size = size
        self._full_us = size * self._byte_ns // 1000
        self._empty_us = ticks_us()

    def room(self):
        """Return the number of free bytes."""
        now = ticks_us()
        left_us = ticks_diff(self._empty_us, now)
        if left_us <= 0 or left_us > self._full_us:
            self._empty_us = now
            return self._size
        return self._size - left_us * 1000 // self._byte_ns - 1

    def is_empty(self):
        """Return True if the buffer is empty."""
        return self.room() == self._size

    def wrote(self, count):
        """Count `count` bytes as written; call `room` before."""
        self._empty_us = ticks_add(self._empty_us, count * self._byte_ns // 1000 + 1)


class UartLink(Link):
    """A link over a UART opened with timeout=0 and a send buffer of `size` bytes.

    Half of the buffer is used: an ESP32 stores up to 28 bytes of its own with each write.
    """

    def __init__(self, uart, baud, size):
        super().__init__()
        self.limit = _CHUNK
        self._uart, self._baud = uart, baud
        self._one = bytearray(1)
        self._pace = Pace(baud, size // 2)

    def _accept(self, raw, at, size):
        if self._pace.room() < size:
            return 0
        accepted = _write(self._uart, raw, at, size)
        if accepted:
            self._pace.wrote(accepted)
        return accepted

    def sleep(self, ms):
        """Sleep once everything is sent; the sleep changes the clock of the UART, which is set again."""
        while not self._pace.is_empty():
            sleep_ms(1)
        machine.lightsleep(ms)
        self._uart.init(self._baud)

    def _byte(self):
        if self._uart.any() and self._uart.readinto(self._one):
            return self._one[0]
        return -1


class ConsoleLink(UsbLink):
    """A link over the console of an ESP32, which is a UART whatever USB socket the board has."""

    CHUNK = _CHUNK

    def __init__(self):
        super().__init__()
        self._pace = Pace(CONSOLE_BAUD, _CONSOLE_FIFO)

    def _accept(self, raw, at, size):
        if self._pace.room() < size:
            return 0
        accepted = UsbLink._accept(self, raw, at, size)
        if accepted:
            self._pace.wrote(accepted)
        return accepted
