"""Sampling by polling the output registers: a sample that may be torn or has no index is discarded."""

from array import array
from time import ticks_add, ticks_diff, ticks_us

from look import Look
from micropython import const
from outbox import FIRST_ROW, ROW
from wire import BATCH_FLAG_GAP_BEFORE

_LOOK_WIRE_US = const(97)
_READ_WIRE_US = const(430)
"""us on the bus of a transfer of one byte, and of fifteen or sixteen."""


class PolledSamples:
    """Reads samples for `sampler` from the output registers of a chip."""

    left = 0
    """Samples in the chip that the clock has already counted: none."""

    def __init__(self, sampler, chip):
        self._sampler = sampler
        self._chip = chip
        self._look = Look(ticks_us(), _LOOK_WIRE_US)
        self._read = Look(ticks_us(), _READ_WIRE_US)
        self._empty_us = ticks_us()
        """Ticks of the last poll that showed no new sample."""
        self._begins = True
        self._gave_up = False
        """True if a sample was read that the sample clock has not counted."""
        self._spare = array("h", bytes(2 * ROW))

    def begin(self, now, resume):
        """Start with the first poll that shows no sample; samples lost before are counted in any case."""
        self._empty_us = now
        self._begins, self._gave_up = True, False

    def turn(self, now):
        """Poll the chip once; read the sample if there is one."""
        sampler, chip, look = self._sampler, self._chip, self._look
        clock = sampler.clock
        begun = ticks_us()
        ready = chip.ready()
        look.took(now, begun, ticks_us())
        if self._begins and ready:
            # It was taken during the configuration, at an unknown time.
            chip.read_into(sampler.slot.values, FIRST_ROW)
            return
        if not ready:
            self._begins = False
            self._empty_us = look.early_us
            if not self._gave_up:
                clock.seen(look.early_us, look.late_us, 0)
            sampler.due_us = look.due_us(clock.aim_us(1)) if clock.locked else now
            return
        read, begun = self._read, ticks_us()
        if not chip.read_into(sampler.slot.values, FIRST_ROW + ROW * sampler.count):
            return
        done = ticks_us()
        read.took(begun, begun, done)
        known = self._one_came(done)
        same = known or clock.before(done, 2)
        if not same and not clock.sure(read.early_us, done, 1):
            # Torn or without an unambiguous index: the clock counts it with the next one.
            self._gave_up = True
            sampler.given_up += 1
            sampler.due_us = now
            return
        half_us = clock.period_us >> 1
        if known:
            came_us = ticks_add(look.late_us, -(ticks_diff(look.late_us, self._empty_us) >> 1))
        else:
            came_us = ticks_add(read.early_us, -half_us)
        skipped = clock.skipped(came_us, 1)
        if skipped:
            clock.interrupted(skipped)
            self._skip(skipped)
        clock.seen(read.early_us, look.late_us if same else read.late_us, 1 + skipped)
        self._gave_up = False
        sampler.last_us = now
        if not sampler.count:
            sampler.began(clock.t_us, clock.index)
        sampler.count += 1
        if sampler.count == sampler.batch:
            sampler.flush()
        if clock.locked:
            sampler.due_us = look.due_us(clock.aim_us(1))
        else:
            sampler.due_us = ticks_add(clock.t_us, clock.period_us * 3 // 4)

    def _one_came(self, done):
        """Return True if exactly one sample was taken since the last poll without one: it cannot be torn.

        Less than a period has passed since that poll, and the index of the sample is unambiguous.
        """
        clock = self._sampler.clock
        known_us = ticks_diff(done, self._empty_us)
        if not 0 <= known_us < clock.period_us - (clock.period_us >> 3):
            return False
        return clock.locked or clock.tells(self._empty_us, self._look.late_us)

    def _skip(self, skipped):
        """Close the batch before a gap; the sample after the gap becomes the first of the next batch."""
        sampler, spare = self._sampler, self._spare
        sampler.missed += skipped
        values, at = sampler.slot.values, FIRST_ROW + ROW * sampler.count
        for i in range(ROW):
            spare[i] = values[at + i]
        sampler.flush()
        sampler.flags |= BATCH_FLAG_GAP_BEFORE
        values = sampler.slot.values
        for i in range(ROW):
            values[FIRST_ROW + i] = spare[i]
