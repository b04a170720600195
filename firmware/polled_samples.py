"""Sampling by polling the output registers: a sample that may be torn or has no index is discarded."""

from array import array
from time import ticks_add, ticks_diff, ticks_us

from micropython import const
from outbox import FIRST_ROW, ROW
from poll_timing import PollTiming
from wire import BATCH_FLAG_GAP_BEFORE

_READY_WIRE_US = const(97)
_READ_WIRE_US = const(430)
"""us on the bus of a transfer of one byte, and of fifteen or sixteen."""


class PolledSamples:
    """Reads samples for `sampler` from the output registers of a chip."""

    left = 0
    """Samples in the chip that the clock has already counted: none."""

    def __init__(self, sampler, chip):
        self._sampler = sampler
        self._chip = chip
        self._poll = PollTiming(ticks_us(), _READY_WIRE_US if chip.address else 0)
        self._read = PollTiming(ticks_us(), _READ_WIRE_US if chip.address else 0)
        self._empty_us = ticks_us()
        """Ticks of the last poll that showed no new sample."""
        self._starting = True
        self._discarded = False
        """True if a sample was read that the sample clock has not counted."""
        self._spare = array("h", bytes(2 * ROW))

    def start(self, now, resume):
        """Start with the first poll that shows no sample; samples lost before are counted in any case."""
        self._empty_us = now
        self._starting, self._discarded = True, False

    def step(self, now):
        """Poll the chip once; read the sample if there is one."""
        sampler, chip, poll = self._sampler, self._chip, self._poll
        clock = sampler.clock
        start_us = ticks_us()
        ready = chip.ready()
        poll.record(now, start_us, ticks_us())
        if self._starting and ready:
            # The first sample was taken during the configuration, at an unknown time.
            chip.read_into(sampler.slot.values, FIRST_ROW)
            return
        if not ready:
            self._starting = False
            self._empty_us = poll.early_us
            if not self._discarded:
                clock.update(poll.early_us, poll.late_us, 0)
            sampler.due_us = poll.due_us(clock.aim_us(1)) if clock.locked else now
            return
        read, start_us = self._read, ticks_us()
        if not chip.read_into(sampler.slot.values, FIRST_ROW + ROW * sampler.count):
            return
        done_us = ticks_us()
        read.record(start_us, start_us, done_us)
        known = self._is_single(done_us)
        same = known or clock.is_before(done_us, 2)
        if not same and not clock.is_certain(read.early_us, done_us, 1):
            # Torn or without an unambiguous index: the clock counts it with the next one.
            self._discarded = True
            sampler.discarded += 1
            sampler.due_us = now
            return
        half_us = clock.period_us >> 1
        if known:
            sampled_us = ticks_add(poll.late_us, -(ticks_diff(poll.late_us, self._empty_us) >> 1))
        else:
            sampled_us = ticks_add(read.early_us, -half_us)
        skipped = clock.skipped(sampled_us, 1)
        if skipped:
            clock.gap(skipped)
            self._skip(skipped)
        clock.update(read.early_us, poll.late_us if same else read.late_us, 1 + skipped)
        self._discarded = False
        sampler.last_us = now
        if not sampler.count:
            sampler.open_batch(clock.t_us, clock.index)
        sampler.count += 1
        if sampler.count == sampler.batch:
            sampler.flush()
        if clock.locked:
            sampler.due_us = poll.due_us(clock.aim_us(1))
        else:
            sampler.due_us = ticks_add(clock.t_us, clock.period_us * 3 // 4)

    def _is_single(self, done_us):
        """Return True if exactly one sample was taken since the last poll without one: it cannot be torn.

        Less than a period has passed since that poll, and the index of the sample is unambiguous.
        """
        clock = self._sampler.clock
        known_us = ticks_diff(done_us, self._empty_us)
        if not 0 <= known_us < clock.period_us - (clock.period_us >> 3):
            return False
        return clock.locked or clock.identifies(self._empty_us, self._poll.late_us)

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
