"""Samples polled one by one from the chip's output registers: whole, numbered, or given up."""

from array import array
from time import ticks_add, ticks_diff, ticks_us

from look import Look
from micropython import const
from outbox import FIRST_ROW, ROW
from wire import BATCH_FLAG_GAP_BEFORE

_LOOK_WIRE_US = const(97)
_READ_WIRE_US = const(430)
"""Transfers of one byte, and of fifteen or sixteen."""


class PolledSamples:
    """What `sampler` does with a chip that shows one sample at a time."""

    left = 0
    """Samples that wait in the chip and are counted already: none."""

    def __init__(self, sampler, chip):
        self._sampler = sampler
        self._chip = chip
        self._look = Look(ticks_us(), _LOOK_WIRE_US)
        self._read = Look(ticks_us(), _READ_WIRE_US)
        self._empty_us = ticks_us()
        """When the chip last had nothing new."""
        self._begins = True
        self._gave_up = False
        """Whether a sample was read that the clock has not been told of."""
        self._spare = array("h", bytes(2 * ROW))

    def begin(self, now, resume):
        """Samples count from the first look without one; what was lost before is counted in any case."""
        self._empty_us = now
        self._begins, self._gave_up = True, False

    def turn(self, now):
        """One look at the chip, and the sample when it is there."""
        sampler, chip, look = self._sampler, self._chip, self._look
        clock = sampler.clock
        begun = ticks_us()
        ready = chip.ready()
        look.took(now, begun, ticks_us())
        if self._begins and ready:
            # It came while everything was set up, nobody knows when.
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
            # Torn, or without a number. The clock counts it with the next.
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
        """Whether exactly one sample came since the chip had none, so that the one read by `done` is whole.

        Less than a period has passed since, then. It must also be known which one it is.
        """
        clock = self._sampler.clock
        known_us = ticks_diff(done, self._empty_us)
        if not 0 <= known_us < clock.period_us - (clock.period_us >> 3):
            return False
        return clock.locked or clock.tells(self._empty_us, self._look.late_us)

    def _skip(self, skipped):
        """Closes the batch before a gap; the sample behind it moves to the front of the next."""
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
