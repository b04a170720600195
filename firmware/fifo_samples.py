"""Sampling through the chip's FIFO: polled when a batch is due, read in bursts, overflows counted."""

from time import ticks_add, ticks_diff, ticks_us

from micropython import const
from poll_timing import TRIES, PollTiming
from wire import BATCH_FLAG_FIFO_OVERRUN, BATCH_FLAG_GAP_BEFORE

_LEVEL_WIRE_US = const(120)
"""A transfer of two bytes."""
_TEMPERATURE_US = const(1000000)
_FIRST_POLLS = const(64)
_SLOW_POLL_US = const(500)
"""A poll that took this much longer than the quickest one, and half a period, is repeated."""


class FifoSamples:
    """Reads samples for `sampler` from a chip with a FIFO."""

    def __init__(self, sampler, chip):
        self._sampler = sampler
        self._chip = chip
        self._poll = PollTiming(ticks_us(), _LEVEL_WIRE_US if chip.address else 0)
        self.left = 0
        """Samples in the FIFO that the sample clock has already counted."""
        self._late_us = self._tries = self._slack_us = 0
        self._realigned = chip.realigned
        self._starting = self._resume = self._torn = False
        self._temperature_us = ticks_us()

    def start(self, now, resume):
        """Start with the next turn; resume: the sample clock counts what was lost before."""
        half_us = self._sampler.clock.period_us >> 1
        self._slack_us = half_us if half_us > _SLOW_POLL_US else _SLOW_POLL_US
        self._starting, self._resume = not resume, resume

    def step(self, now):
        """Poll the FIFO level once; read a burst when a full batch is in it."""
        sampler, chip, poll = self._sampler, self._chip, self._poll
        if self._starting:
            self._starting = False
            self._await_first()
            return
        if self._torn:
            self._torn = False
            self._empty(now, BATCH_FLAG_GAP_BEFORE)
            return
        start_us = ticks_us()
        level = chip.fifo_level()
        poll.record(now, start_us, ticks_us())
        if level < 0:
            sampler.overruns += 1
            self._empty(now, BATCH_FLAG_FIFO_OVERRUN | BATCH_FLAG_GAP_BEFORE)
            return
        if poll.slack_us > self._slack_us and self._tries < TRIES:
            self._tries += 1
            return
        if not self._count(now, level):
            return
        self._tries = 0
        if level >= sampler.batch:
            if not self._burst(now, start_us, level):
                return
            level -= sampler.batch
        self.left = level
        clock = sampler.clock
        if level >= sampler.batch:
            sampler.due_us = now
        else:
            aim_us = clock.aim_us(1 if clock.is_wide() else sampler.batch - level)
            sampler.due_us = poll.due_us(aim_us)

    def _await_first(self):
        """Discard samples from before the start, of unknown time; poll for the next without pause."""
        chip, poll, clock = self._chip, self._poll, self._sampler.clock
        chip.fifo_flush()
        for _ in range(_FIRST_POLLS):
            start_us = ticks_us()
            level = chip.fifo_level()
            poll.record(start_us, start_us, ticks_us())
            if level:
                break
            clock.update(poll.early_us, poll.late_us, 0)
        if level > 0 and self._count(start_us, level):
            self.left = level

    def _count(self, now, level):
        """Update the sample clock with the poll; return False if it was ambiguous or the FIFO was flushed."""
        sampler, poll = self._sampler, self._poll
        clock = sampler.clock
        new = level - self.left
        lost = 0
        if self._chip.realigned != self._realigned:
            # The torn sample counts as a lost one.
            self._realigned = self._chip.realigned
            lost = 1
        if new < 0:
            # The chip was reset, or a failed read consumed samples: those in the FIFO have no index.
            self._empty(now, BATCH_FLAG_GAP_BEFORE)
            return False
        if self._resume:
            if level:
                sure = not clock.locked or clock.is_certain(poll.early_us, poll.late_us, new + lost)
                if not sure and self._tries < TRIES:
                    # Another moment tells unambiguously how many samples were lost.
                    self._tries += 1
                    self._realigned -= lost
                    sampler.due_us = ticks_add(now, clock.period_us >> 2)
                    return False
                self._resume = False
                self._late_us = 0
                lost += clock.skipped(ticks_add(poll.early_us, -(clock.period_us >> 1)), new + lost)
                clock.gap(lost)
        elif new and self._skips(poll.early_us, new + lost):
            # The position of the gap among the samples in the FIFO is unknown, hence their times too.
            self._empty(now, BATCH_FLAG_GAP_BEFORE)
            return False
        if lost:
            sampler.missed += lost
            sampler.flags |= BATCH_FLAG_GAP_BEFORE
        clock.update(poll.early_us, poll.late_us, new + lost)
        if new:
            sampler.last_us = now
        return True

    def _burst(self, now, start_us, level):
        """Read a batch; return False if the FIFO overflowed meanwhile."""
        sampler, chip = self._sampler, self._chip
        clock = sampler.clock
        # A failed burst consumes an unknown number of words: all samples in the FIFO are lost.
        self._torn = True
        sampler.missed += level
        self.left = 0
        broken = chip.fifo_read_into(sampler.slot.rows)
        self._torn = False
        if broken:
            # The chip's own counters or time stamps show that it skipped samples among these.
            self._empty(now, BATCH_FLAG_GAP_BEFORE)
            return False
        if ticks_diff(ticks_us(), start_us) > (chip.FIFO_SAMPLES - 1 - level) * clock.period_us:
            # The FIFO has overflowed since the poll: the burst may begin within a sample.
            sampler.overruns += 1
            self._empty(now, BATCH_FLAG_FIFO_OVERRUN | BATCH_FLAG_GAP_BEFORE)
            return False
        sampler.missed -= level
        sampler.open_batch(clock.ahead_us(1 - level), clock.index + 1 - level)
        sampler.count = sampler.batch
        sampler.flush()
        if ticks_diff(now, self._temperature_us) > 0:
            self._temperature_us = ticks_add(now, _TEMPERATURE_US)
            chip.read_temperature()
        return True

    def _skips(self, at_us, samples):
        """Return True if the chip skipped at least two samples: they are overdue at one stroke.

        A sample rate that decreases makes them overdue gradually, which the sample clock follows.
        """
        clock = self._sampler.clock
        late, before = clock.late_us(at_us, samples), self._late_us
        self._late_us = late
        period = clock.period_us
        quarter = period >> 2
        return late > 2 * period - quarter and late - before > period - quarter

    def _empty(self, now, flags):
        """Flush the FIFO; the sample clock counts the lost samples when the next ones arrive."""
        sampler = self._sampler
        self._chip.fifo_flush()
        sampler.missed += self.left
        sampler.flags |= flags
        self._resume = True
        self.left = self._tries = 0
        sampler.due_us = ticks_add(now, sampler.batch * sampler.clock.period_us)
