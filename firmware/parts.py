"""The chips on the bus: search, configuration, supervision and recovery, with their faults."""

import gc
from time import ticks_add, ticks_diff, ticks_ms, ticks_us

# Loaded with the firmware: a slot that lacks the file must not load.
import drivers.lis3mdl  # noqa: F401
from drivers.chip import acknowledges, nearest, read_register
from micropython import const
from wire import (
    FAULT_BUS_STUCK,
    FAULT_IMU_MISSING,
    FAULT_IMU_SILENT,
    FAULT_POLLED_TOO_FAST,
    FAULT_WRONG_WHO_AM_I,
    IMU_BATCH_MAX_ROWS,
    RESET_CAUSE_BROWN_OUT,
    RESET_CAUSE_HARD,
    RESET_CAUSE_POWER_ON,
    RESET_CAUSE_UNKNOWN,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

IMU_DRIVERS = (
    ("drivers.lsm6ds33", "LSM6DS33", (0x6B, 0x6A)),
    ("drivers.mpu6050", "MPU6050", (0x68, 0x69)),
)
"""(module, class, I2C addresses) in the order of the search; a module is loaded when a chip acknowledges.

MPU6050 accepts clones with any WHO_AM_I: other chips at its addresses come before it.
"""

MAG_DRIVERS = (("drivers.lis3mdl", "LIS3MDL", (0x1E, 0x1C)),)

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
_WITHOUT_POWER = (RESET_CAUSE_UNKNOWN, RESET_CAUSE_POWER_ON, RESET_CAUSE_BROWN_OUT)
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
        self._pause_us = self._check_us = self._since_us = ticks_us()
        self._discarded = 0
        self._too_fast = False

    def find(self):
        """Search for an IMU and a magnetometer and configure them."""
        i2c, s = self._board.i2c, self._board.settings
        self._search_ms = ticks_ms()
        self.chips = []
        self.chip = self.mag = None
        self.faults &= ~(FAULT_IMU_MISSING | FAULT_WRONG_WHO_AM_I | FAULT_IMU_SILENT)
        imu = self._probe(IMU_DRIVERS)
        if imu is None:
            self.faults |= FAULT_WRONG_WHO_AM_I if self.chips else FAULT_IMU_MISSING
        else:
            driver, address, who_am_i = imu
            try:
                self.chip = driver(
                    i2c,
                    address,
                    odr_hz=nearest(driver.RATES_HZ, s["rate_hz"])[0],
                    range_dps=nearest(driver.RANGES_DPS, s["gyro_range_dps"])[0],
                    range_g=nearest(driver.RANGES_G, s["accel_range_g"])[0],
                    fifo=self._wants_fifo(),
                )
                if self.chip.uses_fifo and not self._wants_fifo():
                    self.faults |= FAULT_POLLED_TOO_FAST
                self.chips.append((address, who_am_i, self.chip.PART))
                self._correct_cause()
            except OSError:
                self.i2c_errors += 1
                self.faults |= FAULT_IMU_MISSING
        mag = self._probe(MAG_DRIVERS)
        if mag is not None:
            driver, address, who_am_i = mag
            part, rate_hz = 0, s["mag_rate_hz"]
            try:
                if rate_hz:
                    self.mag = driver(i2c, address, odr_hz=nearest(driver.RATES_HZ, rate_hz)[0])
                    part = driver.PART
            except OSError:
                self.i2c_errors += 1
            self.chips.append((address, who_am_i, part))
        gc.collect()

    def _probe(self, drivers):
        """Return (driver, address, WHO_AM_I) of the first chip that a driver recognises, else None.

        Every other chip that acknowledges at one of the addresses goes into `chips` with Part 0.
        """
        i2c, chosen = self._board.i2c, None
        for module, name, addresses in drivers:
            for address in addresses:
                if (chosen is not None and chosen[1] == address) or not acknowledges(i2c, address):
                    continue
                driver = getattr(__import__(module, None, None, (name,)), name)
                who_am_i = driver.probe(i2c, address)
                for row in self.chips:
                    if row[0] == address:
                        # A driver before this one did not recognise it.
                        self.chips.remove(row)
                        break
                if chosen is None and who_am_i >= 0:
                    chosen = (driver, address, who_am_i)
                else:
                    self.chips.append((address, read_register(i2c, address, driver.WHO_AM_I_REGISTER), 0))
        return chosen

    def _wants_fifo(self):
        """Return True if samples must come through the FIFO: by setting, with Wi-Fi, or if polling failed."""
        s = self._board.settings
        return s["fifo"] or s["link"] == "udp" or self._too_fast

    def start(self, lost):
        """Start sampling the IMU; lost: samples were missed meanwhile."""
        chip = self.chip
        self.batch = self._board.settings["batch"] or default_batch(chip.rate_mhz)
        if self.batch != self._shape:
            self._shape = self.batch
            self._outbox.shape(self.batch)
        now = ticks_us()
        self._check_us = ticks_add(now, _SILENT_LEAST_US)
        self._sampler.start(now, chip, self.batch, lost)

    def bus_error(self, error, now):
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
            if part is not None:
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

    def _correct_cause(self):
        """Correct the reset cause: an IMU that was running kept its power, so it was no power-on."""
        if self.was_running is not None:
            return
        self.was_running = self.chip.was_running
        if self.was_running and self._board.reset_cause in _WITHOUT_POWER:
            self._board.reset_cause = RESET_CAUSE_HARD

    def _configure(self, always):
        """Configure the chip again if it lost its settings, or always; return False if it does not answer.

        A chip with another WHO_AM_I starts a new search.
        """
        chip = self.chip
        try:
            if always or not chip.intact():
                if read_register(self._board.i2c, chip.address, chip.WHO_AM_I_REGISTER) not in (
                    chip.who_am_i,
                    -1,
                ):
                    self._sampler.end()
                    self._search()
                else:
                    if not always:
                        # A setting was lost.
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
        """Configure a chip again that acknowledges but delivers no samples."""
        if not self._silent(now):
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
