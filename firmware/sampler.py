"""From chip to queue: samples with their times into batches, without allocation and without inventing any."""

import struct
from array import array
from time import ticks_add, ticks_diff, ticks_us

from framing import PAYLOAD
from micropython import const
from outbox import FIRST_ROW, Slot
from sample_clock import SampleClock
from wire import (
    BATCH_FLAG_FIFO_OVERRUN,
    BATCH_FLAG_GAP_BEFORE,
    BATCH_FLAG_SATURATED,
    IMU_BATCH,
    IMU_BATCH_FORMAT,
    IMU_BATCH_ROW_SIZE,
    IMU_BATCH_SIZE,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_STATUS_US = const(90)
"""From the start of a transfer to its first byte, at 400 kHz: when the chip decides what it shows."""
_ROW = const(6)
_FULL_SCALE = const(32767)
_TEMPERATURE_US = const(1000000)
_COUNTED_GAP_US = const(100000000)
"""Samples lost in a gap up to this long are counted by the clock."""
_LOOK_US = const(500)
"""A look at the chip that takes longer, and half a period, was held up: when it saw the chip is not known."""
_TRIES = const(3)
"""So many looks are given up for that; a processor that is always so slow gets what it can see."""


class Sampler:
    """Takes samples from `chip` when they are due and hands full batches to `outbox` and to `use`.

    use(values, first, count): what else wants the rows, before they are sealed into a frame.
    `turn` lets the OSError of a failed transfer through; `begin` goes on after it.
    """

    def __init__(self, outbox, use):
        self.clock = SampleClock()
        self.chip: Any = None
        self.missed = 0
        self.overruns = 0
        self.last_us = ticks_us()
        """When the last sample was seen; since `begin`, when that was."""
        self.due_us = self.last_us
        self._outbox = outbox
        self._use = use
        self._batch = 1
        self._slot = Slot()
        self._spare = array("h", bytes(2 * _ROW))
        self._count = 0
        self._flags = 0
        self._first_us = self.last_us
        self.first_index = 0
        """Number of the first sample of the batch handed to `use`."""
        self._first_look = True
        self._rate_mhz = 0
        self._look_us = _LOOK_US
        self._late_us = self._held_up = 0
        self._empty_us = self.last_us
        self._left = 0
        """Samples in the chip's FIFO that the clock has counted already."""
        self._realigned = 0
        self._resume = False
        self._torn = False
        self._temperature_us = self.newest_us = self.last_us
        """Time of the last sample of the batch handed to `use`."""

    def begin(self, now, chip, batch, lost):
        """Samples from a freshly configured chip on; lost: it should have been sampling in between."""
        self._flush()
        clock = self.clock
        period_ns = 1000000000000 // chip.rate_mhz
        known = clock.locked and self._rate_mhz == chip.rate_mhz
        if lost:
            self.missed += self._left
        if known and lost and ticks_diff(now, clock.t_us) < _COUNTED_GAP_US:
            clock.rephase()
            self._resume = True
        else:
            clock.start(period_ns)
            self._resume = False
        if clock.index >= 0:
            self._flags = BATCH_FLAG_GAP_BEFORE
        self.chip = chip
        self._rate_mhz = chip.rate_mhz
        half_us = clock.period_us >> 1
        self._look_us = half_us if half_us > _LOOK_US else _LOOK_US
        self._batch = batch
        self._slot.shape(batch)
        self._left = self._held_up = self._late_us = 0
        self._empty_us = now
        self._torn = False
        self._realigned = chip.realigned
        self._first_look = True
        self.last_us = self.due_us = self._temperature_us = now

    def end(self):
        """Stops; what is in the open batch is sent."""
        self._flush()
        self.chip = None

    def turn(self, now):
        """Looks at the chip when a sample or batch is due."""
        if self.chip is None:
            if ticks_diff(now, self.clock.t_us) > _COUNTED_GAP_US:
                # Before the ticks begin anew, and the gap would look short.
                self.clock.locked = False
        elif ticks_diff(self.due_us, now) > 0:
            return
        elif self.chip.uses_fifo:
            self._turn_fifo(now)
        else:
            self._turn_polled(now)

    def _turn_polled(self, now):
        clock, chip = self.clock, self.chip
        if not chip.ready():
            self._empty_us = now
            clock.seen(ticks_add(now, _STATUS_US), 0, self._first_look)
            self._first_look = False
            self.due_us = now
            return
        at = FIRST_ROW + _ROW * self._count
        begun = ticks_us()
        if not chip.read_into(self._slot.values, at):
            return
        if not self._whole(begun, ticks_us()):
            # Given up; the clock counts it with the next.
            self._first_look = False
            self.due_us = now
            return
        at_us = ticks_add(begun, _STATUS_US)
        skipped = clock.skipped(at_us, 1)
        if skipped:
            clock.interrupted()
            self._skip(skipped)
        clock.seen(at_us, 1 + skipped, self._first_look)
        self._first_look = True
        self.last_us = now
        row = self._count
        if row == 0:
            self._first_us, self.first_index = clock.t_us, clock.index
            clock.batch_began()
        self._count = row + 1
        if self._count == self._batch:
            self._flush()
        if clock.locked:
            self.due_us = ticks_add(clock.ahead_us(1), -_STATUS_US)
        else:
            self.due_us = ticks_add(clock.t_us, clock.period_us * 3 // 4)

    def _whole(self, begun, done):
        """Whether no new sample can have come while one was read: it would be torn, and no flag would tell.

        Known from a look that found nothing, less than a period before; or else from the clock. Before there
        is a clock, that look must also tell which sample it is: to 3/8 of a period.
        """
        clock = self.clock
        period = clock.period_us
        limit = period - (period >> 3)
        known_us = ticks_diff(done, self._empty_us)
        if clock.locked:
            if 0 <= known_us < limit:
                return True
            late = ticks_diff(begun, clock.ahead_us(1))
            return (late % period if late > 0 else 0) + ticks_diff(done, begun) < limit
        return 0 <= known_us < limit and ticks_diff(begun, self._empty_us) <= 3 * (period >> 3)

    def _turn_fifo(self, now):
        chip, clock, batch = self.chip, self.clock, self._batch
        if self._torn:
            self._empty_fifo(now, BATCH_FLAG_GAP_BEFORE)
            self._torn = False
            return
        begun = ticks_us()
        at_us = ticks_add(begun, _STATUS_US)
        level = chip.fifo_level()
        if level < 0:
            self._empty_fifo(now, BATCH_FLAG_FIFO_OVERRUN | BATCH_FLAG_GAP_BEFORE)
            self.overruns += 1
            return
        if ticks_diff(ticks_us(), begun) > self._look_us and self._held_up < _TRIES:
            self._held_up += 1
            self._first_look = False
            return
        self._held_up = 0
        new = level - self._left
        lost = 0
        if chip.realigned != self._realigned:
            # The torn sample had its time like any other.
            self._realigned = chip.realigned
            lost = 1
        if new < 0:
            # The chip was reset, or a misread took samples away: what still waits has no number.
            self._empty_fifo(now, BATCH_FLAG_GAP_BEFORE)
            return
        if self._resume:
            if level:
                self._resume = False
                self._late_us = 0
                lost += clock.skipped(at_us, new + lost)
                clock.interrupted()
        elif new and self._chip_skipped(at_us, new + lost):
            # Where among the waiting samples the hole is, nobody knows: their times are not known either.
            self._empty_fifo(now, BATCH_FLAG_GAP_BEFORE)
            return
        if lost:
            self.missed += lost
            self._flags |= BATCH_FLAG_GAP_BEFORE
        enough = level >= batch
        clock.seen(at_us, new + lost, self._first_look and enough)
        if new:
            self.last_us = now
        self._first_look = enough
        if enough:
            # A burst that fails takes an unknown number of words with it: all that waited is lost.
            self._torn = True
            self.missed += level
            self._left = 0
            chip.fifo_read_into(self._slot.rows)
            self._torn = False
            if ticks_diff(ticks_us(), begun) > (chip.FIFO_SAMPLES - 1 - level) * clock.period_us:
                # It has overflowed since the look: what was read may begin within a sample.
                self._empty_fifo(now, BATCH_FLAG_FIFO_OVERRUN | BATCH_FLAG_GAP_BEFORE)
                self.overruns += 1
                return
            self.missed -= level
            self._first_us = clock.ahead_us(1 - level)
            self.first_index = clock.index + 1 - level
            clock.batch_began()
            level -= batch
            self._count = batch
            self._flush()
            if ticks_diff(now, self._temperature_us) > 0:
                self._temperature_us = ticks_add(now, _TEMPERATURE_US)
                chip.read_temperature()
        self._left = level
        if clock.locked:
            self.due_us = ticks_add(clock.ahead_us(batch - level), -_STATUS_US)
        else:
            # While the period is being measured, each sample is seen soon after it came.
            self.due_us = ticks_add(clock.t_us, clock.period_us * 3 // 4)

    def _chip_skipped(self, at_us, samples):
        """Whether the chip took at least two samples fewer than its beat: they come too late at one stroke.

        A beat that becomes slower makes them late little by little, and is followed by the clock.
        """
        late, before = self.clock.late_us(at_us, samples), self._late_us
        self._late_us = late
        period = self.clock.period_us
        quarter = period >> 2
        return late > 2 * period - quarter and late - before > period - quarter

    def _empty_fifo(self, now, flags):
        """Starts the FIFO anew; how many samples that costs is counted by the clock when the next come."""
        self.chip.fifo_flush()
        self.missed += self._left
        self._flags |= flags
        self._resume = True
        self._left = 0
        self._first_look = False
        self.due_us = ticks_add(now, self._batch * self.clock.period_us)

    def _skip(self, skipped):
        """Closes the batch before a gap; the sample behind it moves to the front of the next."""
        self.missed += skipped
        spare, values = self._spare, self._slot.values
        at = FIRST_ROW + _ROW * self._count
        for i in range(_ROW):
            spare[i] = values[at + i]
        self._flush()
        self._flags |= BATCH_FLAG_GAP_BEFORE
        values = self._slot.values
        for i in range(_ROW):
            values[FIRST_ROW + i] = spare[i]

    def _flush(self):
        """Hands over the open batch, if anything is in it."""
        count = self._count
        if not count:
            return
        slot, chip = self._slot, self.chip
        self.newest_us = ticks_add(self._first_us, (count - 1) * self.clock.period_ns // 1000)
        self._use(slot.values, FIRST_ROW, count)
        if _saturated(slot, count, self._batch):
            self._flags |= BATCH_FLAG_SATURATED
        struct.pack_into(
            IMU_BATCH_FORMAT,
            slot.raw,
            PAYLOAD,
            self._first_us,
            self.clock.period_ns,
            self.first_index & 0xFFFF,
            chip.temperature_raw,
            self._flags,
            count,
        )
        self._slot = self._outbox.exchange(slot, IMU_BATCH, IMU_BATCH_SIZE + IMU_BATCH_ROW_SIZE * count)
        self._count = 0
        self._flags = 0


def _saturated(slot, count, batch):
    """Whether a value stands at an end of the scale."""
    if count == batch:
        return max(slot.samples) >= _FULL_SCALE or min(slot.samples) < -_FULL_SCALE
    values = slot.values
    for at in range(FIRST_ROW, FIRST_ROW + _ROW * count):
        if not -_FULL_SCALE <= values[at] < _FULL_SCALE:
            return True
    return False
