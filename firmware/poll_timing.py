"""Time bounds of a poll of the chip: what it showed was true at a moment between the two."""

from time import ticks_add, ticks_diff

from micropython import const

_STATUS_US = const(72)
"""From the start of a transfer to its first byte at 400 kHz, when the chip latches what it returns."""
TRIES = const(3)
"""Ambiguous polls in a row that are repeated; a processor that is always slow then takes what it gets."""
_LAG_US = const(1000)
"""A delay before a poll that took longer is an exception and does not count."""


class PollTiming:
    """Timing of polls. early_us, late_us: the last poll showed the state of a moment between them.

    wire_us: duration of the transfer on I2C; 0: the chip is on SPI.
    slack_us: excess over the quickest poll so far.
    """

    def __init__(self, now, wire_us):
        self._wire_us = wire_us
        self._quick_us = 1 << 20
        self._lead_us = _STATUS_US
        self._lag_us = 0
        self.slack_us = 0
        self.early_us = self.late_us = now

    def due_us(self, at_us):
        """Return when to start a poll that shall show the state at `at_us`."""
        return ticks_add(at_us, -self._lead_us - self._lag_us)

    def record(self, out_us, begun_us, done_us):
        """Record a poll from `begun_us` to `done_us` that was called at `out_us`.

        Whatever exceeds the transfer itself is assumed to pass before it, which is nearly true on an RP2040.
        """
        lag_us = ticks_diff(begun_us, out_us)
        if lag_us < _LAG_US:
            self._lag_us += (lag_us - self._lag_us) >> 2
        took_us = ticks_diff(done_us, begun_us)
        if took_us < self._quick_us:
            self._quick_us = took_us
            # On SPI the transfer takes 3 us, after two of four calls.
            self._lead_us = _STATUS_US + took_us - self._wire_us if self._wire_us else took_us >> 1
        self.slack_us = took_us - self._quick_us
        self.early_us = ticks_add(begun_us, self._lead_us)
        self.late_us = ticks_add(self.early_us, self.slack_us)
