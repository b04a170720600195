"""When a look at the chip showed what it showed: between two moments, as close as the processor was quick."""

from time import ticks_add, ticks_diff

from micropython import const

_STATUS_US = const(72)
"""From the start of a transfer to its first byte, at 400 kHz: when the chip decides what it shows."""
TRIES = const(3)
"""So many looks in a row may tell too little; a processor that is always so slow gets what it can see."""
_LAG_US = const(1000)
"""A way to a look that took longer was not the ordinary one."""


class Look:
    """early_us, late_us: what the last look showed was so at some moment between them.

    wire_us: what the transfer takes on the bus. slack_us: how much longer than the quickest it took.
    """

    def __init__(self, now, wire_us):
        self._wire_us = wire_us
        self._quick_us = 1 << 20
        self._lead_us = _STATUS_US
        self._lag_us = 0
        self.slack_us = 0
        self.early_us = self.late_us = now

    def due_us(self, at_us):
        """When to set out for a look that shows what is so at `at_us`."""
        return ticks_add(at_us, -self._lead_us - self._lag_us)

    def took(self, out_us, begun_us, done_us):
        """A look at the chip went on from `begun_us` to `done_us`; the way to it began at `out_us`.

        What is not wire comes before it, the call and the way from address to data: nearly so on an RP2040.
        """
        lag_us = ticks_diff(begun_us, out_us)
        if lag_us < _LAG_US:
            self._lag_us += (lag_us - self._lag_us) >> 2
        took_us = ticks_diff(done_us, begun_us)
        if took_us < self._quick_us:
            self._quick_us = took_us
            self._lead_us = _STATUS_US + took_us - self._wire_us
        self.slack_us = took_us - self._quick_us
        self.early_us = ticks_add(begun_us, self._lead_us)
        self.late_us = ticks_add(self.early_us, self.slack_us)
