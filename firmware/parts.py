"""The chips on the bus: search, configuration, supervision and recovery, with their faults."""

import gc
import sys
from time import ticks_add, ticks_diff, ticks_ms, ticks_us

# Loaded with the firmware: a slot that lacks the file must not load.
import drivers.lis3mdl  # noqa: F401
from drivers.chip import read_register
from micropython import const
from wire import (
    FAULT_BUS_STUCK,
    FAULT_IMU_SILENT,
    FAULT_POLLED_TOO_FAST,
    IMU_BATCH_MAX_ROWS,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_SEARCH_MS = const(1000)
_SETTINGS_MS = const(1000)
_CHECK_US = const(1500)
_POSTPONE_MS = const(50)
_SILENT_LEAST_US = const(100000)
_SILENT_PERIODS = const(10)
_RECONFIGURE_US = const(1000000)
_FAILURES_BEFORE_RECOVERY = const(3)
_RETRY_US = const(2000)
_PAUSE_US = const(250000)
_DISCARD_RATIO = const(16)
"""Polling that discards more than one sample in this many is too fast for this board and bus."""
_ETIMEDOUT = (110, 116)
"""ETIMEDOUT of the two ports: the bus is held low, rather than a chip that does not acknowledge."""


class Parts:
    """The IMU and the magnetometer of a board; starts `sampler` on the IMU.

    chip, mag: their drivers, None while missing. chips: (address, WHO_AM_I, Part) of all that acknowledged.
    searched: called after each search that was not requested.
    """

    def __init__(self, board, outbox, sampler, searched):
        self.chip: Any = None
        self.mag: Any = None
        self.chips = []
        self.faults = 0
        self.was_running: Any = None
        """True if the first IMU was already running when the processor started; None before that is known."""
        self.batch = 8
        self._shape = 0
        self.i2c_errors = self.recoveries = self.failures = 0
        self.paused = False
        """True while the bus is not used after a failed recovery."""
        self._board = board
        self._outbox = outbox
        self._sampler = sampler
        self._on_search = searched
        self._search_ms = self._settings_ms = ticks_ms()
        self._pause_us = self._check_us = self._since_us = self._start_us = ticks_us()
        self._discarded = 0
        self._too_fast = False

    def find(self):
        """Search for an IMU and a magnetometer and configure them."""
        from chip_search import open_chips

        self._search_ms = ticks_ms()
        open_chips(self, self._board, self._too_fast)
        if self.chip is not None:
            del sys.modules["chip_search"]
        gc.collect()

    def start(self, missed):
        """Start sampling the IMU; missed: True if samples were missed meanwhile."""
        chip = self.chip
        self.batch = self._board.settings["batch"] or default_batch(chip.rate_mhz)
        if self.batch != self._shape:
            self._shape = self.batch
            self._outbox.shape(self.batch)
        self._start_us = now = ticks_us()
        self._check_us = ticks_add(now, _SILENT_LEAST_US)
        self._sampler.start(now, chip, self.batch, missed)

    def handle_bus_error(self, error, now):
        """Handle a failed transfer: retry, or recover the bus after three in a row."""
        self.i2c_errors += 1
        self.failures += 1
        self._sampler.due_us = ticks_add(now, _RETRY_US)
        # An exception raised without free memory has no arguments.
        timed_out = error.args and error.args[0] in _ETIMEDOUT
        if not timed_out and (self.failures < _FAILURES_BEFORE_RECOVERY or not self._silent(now)):
            return
        self.failures = 0
        self.recoveries += 1
        free = self._board.free_bus()
        self.faults = self.faults & ~FAULT_BUS_STUCK if free else self.faults | FAULT_BUS_STUCK
        for part in (self.chip, self.mag):
            if part is not None and part.address:
                part.i2c = self._board.i2c
        if not free or not self._configure(False):
            # Each transfer on a stuck bus takes its full time limit: pause rather than retry in every turn.
            self.paused = True
            self._pause_us = ticks_add(now, _PAUSE_US)

    def supervise(self, ms, running):
        """Check that the IMU delivers samples with the right settings; search for a missing one."""
        if self.paused and ticks_diff(ticks_us(), self._pause_us) >= 0:
            self.paused = False
        if self.chip is not None:
            if not self.paused:
                self._watch_imu(ticks_us())
                if self.chip is not None and ticks_diff(ms, self._settings_ms) >= 0:
                    self._check_settings(ms)
        elif running and ticks_diff(ms, self._search_ms) >= _SEARCH_MS:
            self._search()

    def _configure(self, always):
        """Configure the chip again if it lost its settings, or always; return False if it does not answer.

        A chip with another WHO_AM_I starts a new search.
        """
        chip = self.chip
        try:
            if always or not chip.intact():
                if read_register(chip.i2c, chip.address, chip.WHO_AM_I_REGISTER) not in (
                    chip.who_am_i,
                    -1,
                ):
                    self._sampler.end()
                    self._search()
                else:
                    if not always:
                        # A chip that lost a setting counts as a bus error.
                        self.i2c_errors += 1
                    chip.configure()
                    self.start(True)
        except OSError:
            self.i2c_errors += 1
            return False
        return True

    def _search(self):
        """Search again; an IMU that is found is sampled after a gap."""
        self.find()
        if self.chip is not None:
            self.start(True)
        self._on_search()

    def _check_settings(self, ms):
        """Check every second that the settings persist, as a flipped bit would falsify all samples.

        Also check that polling keeps up; otherwise switch to the FIFO. The check is done between two polled
        samples where possible: a chip that became slower is always overdue and leaves no such time.
        """
        soon = not self.chip.uses_fifo and ticks_diff(self._sampler.due_us, ticks_us()) < _CHECK_US
        if soon and ticks_diff(ms, self._settings_ms) < _POSTPONE_MS:
            return
        self._settings_ms = ticks_add(ms, _SETTINGS_MS)
        sampler = self._sampler
        discarded = sampler.discarded - self._discarded
        self._discarded = sampler.discarded
        if discarded * _DISCARD_RATIO > self.chip.rate_mhz // 1000:
            self._too_fast = True
            self.faults |= FAULT_POLLED_TOO_FAST
            self._search()
        else:
            self._configure(False)

    def _watch_imu(self, now):
        """Configure a chip again that delivers no samples; the fault lasts until one arrives."""
        if not self._silent(now):
            if self._sampler.last_us != self._start_us:
                self.faults &= ~FAULT_IMU_SILENT
                self.failures = 0
                self._since_us = now
            return
        self.faults |= FAULT_IMU_SILENT
        if ticks_diff(now, self._check_us) < 0:
            return
        self._check_us = ticks_add(now, _SILENT_LEAST_US)
        always = ticks_diff(now, self._since_us) > _RECONFIGURE_US
        if always:
            self._since_us = now
        self._configure(always)

    def _silent(self, now):
        limit_us = _SILENT_PERIODS * self._sampler.clock.period_us
        if limit_us < _SILENT_LEAST_US:
            limit_us = _SILENT_LEAST_US
        return ticks_diff(now, self._sampler.last_us) >= limit_us


def default_batch(rate_mhz):
    """Return the default samples per batch: some 40 ms, above 1 kHz a full frame."""
    if rate_mhz > 1000000:
        return IMU_BATCH_MAX_ROWS
    return 16 if rate_mhz > 250000 else 8
