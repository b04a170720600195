"""From chip to queue: samples with their times into batches, without allocation and without inventing any."""

import struct
from time import sleep_us, ticks_add, ticks_diff, ticks_us

from framing import PAYLOAD
from micropython import const
from outbox import FIRST_ROW, ROW, Slot
from sample_clock import SampleClock
from wire import (
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

_FULL_SCALE = const(32767)
_SOON_US = const(200)
"""What is due so soon is waited for, to look at the moment that tells most."""
_COUNTED_GAP_US = const(100000000)
"""Samples lost in a gap up to this long are counted by the clock."""


def saturated_plain(values, at, last):
    """Whether one of values[at:last] stands at an end of the scale."""
    while at < last:
        if not -_FULL_SCALE <= values[at] < _FULL_SCALE:
            return True
        at += 1
    return False


try:
    from fast import saturated
except (ImportError, SyntaxError, ValueError, AttributeError, NameError):
    # This interpreter has no native code, or the file was compiled for another processor.
    saturated = saturated_plain  # type: ignore[assignment]


class Sampler:
    """Takes samples from `chip` when they are due and hands full batches to `outbox` and to `use`.

    use(values, first, count): what else wants the rows, before they are sealed into a frame.
    How it takes them is the matter of `fifo_samples` or `polled_samples`, which fill `slot`.
    `turn` lets the OSError of a failed transfer through; `begin` goes on after it.
    """

    def __init__(self, outbox, use):
        self.clock = SampleClock()
        self.chip: Any = None
        self.missed = self.given_up = self.overruns = 0
        """given_up: polled samples that were torn, or had no number."""
        self.last_us = ticks_us()
        """When the last sample was seen; since `begin`, when that was."""
        self.due_us = self.last_us
        self.batch = 1
        self.slot = Slot()
        """The open batch: `count` rows, the first of them sample `first_index` at `first_us`, and `flags`."""
        self.count = self.flags = self.first_index = 0
        self.first_us = self.newest_us = self.last_us
        """newest_us: time of the last sample of the batch handed to `use`."""
        self._outbox = outbox
        self._use = use
        self._samples: Any = None
        self._rate_mhz = 0

    def begin(self, now, chip, batch, lost):
        """Samples from a freshly configured chip on; lost: it should have been sampling in between."""
        self.flush()
        clock = self.clock
        known = clock.locked and self._rate_mhz == chip.rate_mhz
        if lost and self._samples is not None:
            self.missed += self._samples.left
        resume = known and lost and ticks_diff(now, clock.t_us) < _COUNTED_GAP_US
        if resume:
            clock.rephase()
        else:
            clock.start(1000000000000 // chip.rate_mhz)
        if clock.index >= 0:
            self.flags = BATCH_FLAG_GAP_BEFORE
        self.chip = chip
        self._rate_mhz = chip.rate_mhz
        self.batch = batch
        self.slot.shape(batch)
        self.last_us = self.due_us = now
        self._samples = _samples(self, chip)
        self._samples.begin(now, resume)

    def end(self):
        """Stops; what is in the open batch is sent."""
        self.flush()
        self.chip = None

    def turn(self, now):
        """Looks at the chip when a sample or batch is due."""
        if self.chip is None:
            if ticks_diff(now, self.clock.t_us) > _COUNTED_GAP_US:
                # Before the ticks begin anew, and the gap would look short.
                self.clock.locked = False
            return
        wait = ticks_diff(self.due_us, now)
        if wait > _SOON_US:
            return
        if wait > 0:
            sleep_us(wait)
        self._samples.turn(ticks_us())

    def began(self, first_us, first_index):
        """The open batch begins with this sample. Its time never comes before that of the batch before."""
        half_us = self.clock.period_us >> 1
        since_us = ticks_diff(first_us, self.newest_us)
        if -8 * half_us < since_us < half_us and first_index:
            first_us = ticks_add(self.newest_us, half_us)
        self.first_us, self.first_index = first_us, first_index

    def flush(self):
        """Hands over the open batch, if anything is in it."""
        count = self.count
        if not count:
            return
        slot, last = self.slot, FIRST_ROW + ROW * count
        self.newest_us = ticks_add(self.first_us, (count - 1) * self.clock.period_ns // 1000)
        self._use(slot.values, FIRST_ROW, count)
        if saturated(slot.values, FIRST_ROW, last):
            self.flags |= BATCH_FLAG_SATURATED
        struct.pack_into(
            IMU_BATCH_FORMAT,
            slot.raw,
            PAYLOAD,
            self.first_us,
            self.clock.period_ns,
            self.first_index & 0xFFFF,
            self.chip.temperature_raw,
            self.flags,
            count,
        )
        self.slot = self._outbox.exchange(slot, IMU_BATCH, IMU_BATCH_SIZE + IMU_BATCH_ROW_SIZE * count)
        self.count = self.flags = 0


def _samples(sampler, chip):
    """The way that samples come from this chip; the other one is not loaded."""
    if chip.uses_fifo:
        from fifo_samples import FifoSamples

        return FifoSamples(sampler, chip)
    from polled_samples import PolledSamples

    return PolledSamples(sampler, chip)
