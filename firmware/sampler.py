"""Read samples from the chip into time-stamped batches without allocation; no sample is interpolated."""

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
_MAX_WAIT_US = const(200)
"""A poll that is due within this time is waited for, as its exact moment determines the time stamp."""
_COUNTED_GAP_US = const(100000000)
"""In gaps up to this long the sample clock counts the lost samples."""


def saturated_plain(values, at, last):
    """Return True if one of values[at:last] is at an end of the scale."""
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
    """Reads samples from `chip` when they are due and passes full batches to `outbox` and to `use`.

    use(values, first, count): called with the rows of a batch before they are sealed into a frame.
    `fifo_samples` or `polled_samples` does the reading, into `slot`.
    `step` raises the OSError of a failed transfer; `start` resumes after it.
    """

    def __init__(self, outbox, use):
        self.clock = SampleClock()
        self.chip: Any = None
        self.missed = self.discarded = self.overruns = 0
        """discarded: polled samples that were discarded: torn, or of unknown index."""
        self.last_us = ticks_us()
        """Ticks at which the last sample was read, or of `start` if none was since."""
        self.due_us = self.last_us
        self.batch = 1
        self.slot = Slot()
        """The open batch: `count` rows with `flags`; the first is sample `first_index` at `first_us`."""
        self.count = self.flags = self.first_index = 0
        self.first_us = self.newest_us = self.last_us
        """newest_us: time of the last sample of the latest batch passed to `use`."""
        self._outbox = outbox
        self._use = use
        self.reader: Any = None
        """`FifoSamples` or `PolledSamples`."""
        self._rate_mhz = 0

    def start(self, now, chip, batch, lost):
        """Start sampling a chip that has just been configured; lost: samples were missed meanwhile."""
        self.flush()
        clock = self.clock
        known = clock.locked and self._rate_mhz == chip.rate_mhz
        if lost and self.reader is not None:
            self.missed += self.reader.left
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
        chip.shape(batch)
        chip.clock = clock
        self.last_us = self.due_us = now
        self.reader = _reader(self, chip)
        self.reader.start(now, resume)

    def end(self):
        """Stop sampling; the open batch is sent."""
        self.flush()
        self.chip = None

    def step(self, now):
        """Poll the chip when a sample or batch is due."""
        if self.chip is None:
            if ticks_diff(now, self.clock.t_us) > _COUNTED_GAP_US:
                # Ticks cannot measure more than 537 s: a longer gap would appear short.
                self.clock.locked = False
            return
        wait = ticks_diff(self.due_us, now)
        if wait > _MAX_WAIT_US:
            return
        if wait > 0:
            sleep_us(wait)
        self.reader.step(ticks_us())

    def open_batch(self, first_us, first_index):
        """Set time and index of the first sample of the open batch; time stamps never run backward."""
        half_us = self.clock.period_us >> 1
        since_us = ticks_diff(first_us, self.newest_us)
        if -8 * half_us < since_us < half_us and first_index:
            first_us = ticks_add(self.newest_us, half_us)
        self.first_us, self.first_index = first_us, first_index

    def flush(self):
        """Pass on the open batch unless it is empty."""
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


def _reader(sampler, chip):
    """Return the reader for this chip; the module of the other one is not loaded."""
    if chip.uses_fifo:
        from fifo_samples import FifoSamples

        return FifoSamples(sampler, chip)
    from polled_samples import PolledSamples

    return PolledSamples(sampler, chip)
