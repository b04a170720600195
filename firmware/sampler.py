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
        self._first_index = 0
        self._first_look = True
        self._left = 0
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
        known = clock.locked and self.chip is not None and self.chip.rate_mhz == chip.rate_mhz
        if known and lost and ticks_diff(now, clock.t_us) < _COUNTED_GAP_US:
            clock.rephase()
            self._resume = True
        else:
            clock.start(period_ns)
            self._resume = False
        if clock.index >= 0:
            self._flags = BATCH_FLAG_GAP_BEFORE
        self.chip = chip
        self._batch = batch
        self._slot.shape(batch)
        self._left = 0
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
        if self.chip is None or ticks_diff(self.due_us, now) > 0:
            return
        if self.chip.uses_fifo:
            self._turn_fifo(now)
        else:
            self._turn_polled(now)

    def _turn_polled(self, now):
        clock, chip = self.clock, self.chip
        at_us = ticks_add(now, _STATUS_US)
        if not chip.ready():
            clock.seen(at_us, 0, self._first_look)
            self._first_look = False
            self.due_us = now
            return
        at = FIRST_ROW + _ROW * self._count
        if not chip.read_into(self._slot.values, at):
            return
        skipped = clock.skipped(at_us, 1)
        if chip.ready():
            # The next sample came while this one was read: it may be torn. Only the new one is whole.
            at_us = ticks_us()
            chip.read_into(self._slot.values, at)
            skipped = clock.skipped(at_us, 1) or 1
        if skipped:
            self._skip(skipped)
        clock.seen(at_us, 1 + skipped, self._first_look)
        self._first_look = True
        self.last_us = now
        row = self._count
        if row == 0:
            self._first_us, self._first_index = clock.t_us, clock.index
            clock.batch_began()
        self._count = row + 1
        if self._count == self._batch:
            self._flush()
        if clock.locked:
            self.due_us = ticks_add(clock.ahead_us(1), -_STATUS_US)
        else:
            self.due_us = ticks_add(clock.t_us, clock.period_us * 3 // 4)

    def _turn_fifo(self, now):
        chip, clock, batch = self.chip, self.clock, self._batch
        if self._torn:
            self._empty_fifo(now, BATCH_FLAG_GAP_BEFORE)
            self._torn = False
            return
        at_us = ticks_add(now, _STATUS_US)
        level = chip.fifo_level()
        if level < 0:
            self._empty_fifo(now, BATCH_FLAG_FIFO_OVERRUN | BATCH_FLAG_GAP_BEFORE)
            self.overruns += 1
            return
        new = level - self._left
        lost = 0
        if chip.realigned != self._realigned:
            # The torn sample had its time like any other.
            self._realigned = chip.realigned
            lost = 1
        if new < 0:
            # The chip emptied its FIFO by itself: it was reset.
            self._resume = True
            new = level
        if self._resume and level:
            self._resume = False
            lost += clock.skipped(at_us, new + lost)
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
            chip.fifo_read_into(self._slot.rows)
            self.missed -= level
            self._torn = False
            self._first_us = clock.ahead_us(1 - level)
            self._first_index = clock.index + 1 - level
            clock.batch_began()
            level -= batch
            self._count = batch
            self._flush()
            if ticks_diff(now, self._temperature_us) > 0:
                self._temperature_us = ticks_add(now, _TEMPERATURE_US)
                chip.read_temperature()
        self._left = level
        self.due_us = ticks_add(clock.ahead_us(batch - level), -_STATUS_US)

    def _empty_fifo(self, now, flags):
        """Starts the FIFO anew; how many samples that costs is counted by the clock when the next come."""
        self.chip.fifo_flush()
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
            self._first_index & 0xFFFF,
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
