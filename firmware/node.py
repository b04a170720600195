"""The node: its parts put together, its loop, and what it does when something fails."""

import gc
import os
import struct
import sys
from time import sleep_ms, sleep_us, ticks_add, ticks_diff, ticks_ms, ticks_us

import bias_filter
import machine
import micropython
import reports
import settings as configuration
from board import Board
from buffers import shared
from commands import Commands
from drivers.lis3mdl import LIS3MDL
from drivers.lsm6ds33 import LSM6DS33
from drivers.mpu6050 import MPU6050
from framing import PAYLOAD
from micropython import const
from outbox import Outbox
from sampler import Sampler
from wire import (
    FAULT_BUS_STUCK,
    FAULT_IMU_MISSING,
    FAULT_IMU_SILENT,
    FAULT_WRONG_WHO_AM_I,
    FILTER_STATE_INITIALISING,
    FILTER_STATE_TRACKING,
    MAG,
    MAG_FORMAT,
    MAG_SIZE,
    REBOOT_MODE_REPL,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

IMU_DRIVERS = (LSM6DS33, MPU6050)
STAY_IN_REPL = "/stay_in_repl"

_HELLO_MS = const(5000)
_HEALTH_MS = const(1000)
_SEARCH_MS = const(1000)
_SETTINGS_MS = const(1000)
_CHECK_US = const(1500)
_SILENT_LEAST_US = const(100000)
_SILENT_PERIODS = const(10)
_RECONFIGURE_US = const(1000000)
_FAILURES_BEFORE_RECOVERY = const(3)
_AGAIN_US = const(2000)
_PAUSE_US = const(250000)
_SENDS_PER_TURN = const(4)
_IDLE_US = const(1000)
_MARGIN_US = const(300)
_MAG_RETRY_MS = const(5)
_MAG_SILENT_MS = const(1000)
_TIMED_OUT = (110, 116)
"""ETIMEDOUT of the two ports: not a chip that says no, but a bus that is held."""
_CTRL_C = const(3)
_FAREWELL_MS = const(300)
_RESCUE_MS = const(3000)


class Node:
    """One node on one board. `turn` is a round of its loop; `leave` becomes a RebootMode when it must end."""

    def __init__(self, board, link):
        self.board = board
        self.link = link
        self.settings = board.settings
        self.outbox = Outbox(self.settings["queue"], self.settings["node_id"])
        self.sampler = Sampler(self.outbox, self._use)
        self.static = bias_filter.StaticInit()
        self.commands = Commands(self)
        self.chip: Any = None
        self.mag: Any = None
        self.faults = 0
        self.leave = None
        self.parts = []
        self.batch = 8
        self.estimator: Any = None
        self._running = True
        self.i2c_errors = self.recoveries = self._failures = 0
        self.worst_us = self._mag_waits = 0
        _, self._mag_words = shared(3)
        now = ticks_ms()
        self._hello_ms = self._health_ms = self._search_ms = self._filter_ms = self._mag_ms = now
        self._settings_ms = now
        self._pause_us = self._check_us = self._since_us = ticks_us()
        self._paused = False
        self.make_filter()
        self.start()

    def turn(self):
        """One round: sample, send, listen, look after everything else."""
        now = ticks_us()
        self.board.feed()
        if self._paused and ticks_diff(now, self._pause_us) >= 0:
            self._paused = False
        if not self._paused:
            try:
                self.sampler.turn(now)
            except OSError as error:
                self._bus_failed(error, ticks_us())
        self.link.send(self.outbox, _SENDS_PER_TURN)
        if self.link.receive():
            self.commands.handle(self.link.reader, ticks_us())
        self._look_after(ticks_ms())
        done = ticks_us()
        took = ticks_diff(done, now)
        if took > self.worst_us:
            self.worst_us = took
        self._idle(done)

    def start(self):
        """Finds the parts, configures them and samples; `chip` is None when there is no IMU."""
        self._running = True
        self._find_parts()
        if self.chip is None:
            self.sampler.end()
        else:
            self._begin(False)
        reports.hello(self)

    def stop(self):
        """Ends sampling; the node goes on answering."""
        self._running = False
        self.sampler.end()
        self.chip = None
        self.commands.bias_given_up()

    def make_filter(self):
        """The estimator that the settings ask for, at rest with the bias of the last initialisation."""
        s = self.settings
        self.estimator = bias_filter.estimator(s["filter_kind"], s["gain_rate_q20"], s["gain_bias_q30"])
        self._begin_filter()

    def farewell(self):
        """Gives the link a little time to take what still waits."""
        until = ticks_add(ticks_ms(), _FAREWELL_MS)
        while self.outbox.count and ticks_diff(until, ticks_ms()) > 0:
            self.link.send(self.outbox, _SENDS_PER_TURN)
            self.board.feed()
            sleep_ms(1)

    # What each batch goes through before it is sealed.

    def _use(self, values, first, count):
        static, estimator = self.static, self.estimator
        if static.state == FILTER_STATE_INITIALISING:
            if static.update(values, first, count):
                self._begin_filter()
                self.commands.bias_done(static.turning)
        elif static.state == FILTER_STATE_TRACKING and estimator is not None:
            estimator.update(values, first, count)

    def _begin_filter(self):
        if self.estimator is not None:
            for axis in range(3):
                self.estimator.begin(axis, self.static.bias_q14[axis])

    # Finding and losing parts.

    def _find_parts(self):
        """Looks for an IMU and a magnetometer at their addresses."""
        i2c, s = self.board.i2c, self.settings
        self._search_ms = ticks_ms()
        self.parts = []
        self.chip = self.mag = None
        self.faults &= ~(FAULT_IMU_MISSING | FAULT_WRONG_WHO_AM_I | FAULT_IMU_SILENT)
        found = wrong = None
        for driver in IMU_DRIVERS:
            for address in driver.ADDRESSES:
                who_am_i = _who_am_i(i2c, address, driver.WHO_AM_I_REGISTER)
                if who_am_i < 0:
                    continue
                if found is None and (who_am_i in driver.WHO_AM_I or driver.ANY_WHO_AM_I):
                    found = (driver, address, who_am_i)
                else:
                    wrong = (address, who_am_i, 0)
                    self.parts.append(wrong)
        if found is None:
            self.faults |= FAULT_IMU_MISSING if wrong is None else FAULT_WRONG_WHO_AM_I
        else:
            driver, address, who_am_i = found
            try:
                self.chip = driver(
                    i2c,
                    address,
                    odr_hz=_nearest(driver.RATES_HZ, s["rate_hz"]),
                    range_dps=_nearest(driver.RANGES_DPS, s["gyro_range_dps"]),
                    range_g=_nearest(driver.RANGES_G, s["accel_range_g"]),
                    fifo=s["fifo"],
                )
                self.parts.append((address, who_am_i, self.chip.PART))
            except OSError:
                self.i2c_errors += 1
                self.faults |= FAULT_IMU_MISSING
        self._find_mag()
        gc.collect()

    def _find_mag(self):
        i2c, rate_hz = self.board.i2c, self.settings["mag_rate_hz"]
        for address in LIS3MDL.ADDRESSES:
            who_am_i = _who_am_i(i2c, address, LIS3MDL.WHO_AM_I_REGISTER)
            if who_am_i < 0:
                continue
            part = 0
            if who_am_i in LIS3MDL.WHO_AM_I and rate_hz and self.mag is None:
                try:
                    self.mag = LIS3MDL(i2c, address, odr_hz=_nearest(LIS3MDL.RATES_HZ, rate_hz))
                    part = LIS3MDL.PART
                except OSError:
                    self.i2c_errors += 1
            self.parts.append((address, who_am_i, part))

    def _begin(self, lost):
        chip = self.chip
        self.batch = self.settings["batch"] or (16 if chip.rate_mhz > 250000 else 8)
        if not lost:
            self.outbox.shape(self.batch)
        now = ticks_us()
        self._check_us = ticks_add(now, _SILENT_LEAST_US)
        self.sampler.begin(now, chip, self.batch, lost)

    def _bus_failed(self, error, now):
        self.i2c_errors += 1
        self._failures += 1
        self.sampler.due_us = ticks_add(now, _AGAIN_US)
        # An error that no memory was left for has no arguments.
        timed_out = error.args and error.args[0] in _TIMED_OUT
        if self._failures < _FAILURES_BEFORE_RECOVERY and not timed_out:
            return
        self._failures = 0
        self.recoveries += 1
        free = self.board.free_bus()
        self.faults = self.faults & ~FAULT_BUS_STUCK if free else self.faults | FAULT_BUS_STUCK
        for part in (self.chip, self.mag):
            if part is not None:
                part.i2c = self.board.i2c
        if not free or not self._revive(False):
            # Each transfer on a bus that stays stuck costs its whole time limit: not at every turn.
            self._paused = True
            self._pause_us = ticks_add(now, _PAUSE_US)

    def _revive(self, always):
        """Configures the chip again if it lost its settings, or always; False when it does not answer.

        One that answers with another id is given up.
        """
        chip = self.chip
        try:
            if always or not chip.intact():
                if _who_am_i(self.board.i2c, chip.address, chip.WHO_AM_I_REGISTER) not in (chip.who_am_i, -1):
                    self.sampler.end()
                    self._search()
                else:
                    if not always:
                        # What was written there did not stay.
                        self.i2c_errors += 1
                    chip.configure()
                    self._begin(True)
        except OSError:
            self.i2c_errors += 1
            return False
        return True

    def _search(self):
        """Looks for the parts again; an IMU that is there is sampled on, with a gap."""
        self._find_parts()
        if self.chip is not None:
            self._begin(True)
        reports.hello(self)

    def _check_settings(self, ms):
        """A bit of a setting that turned over would go on changing samples: looked for every second."""
        if not self.chip.uses_fifo and ticks_diff(self.sampler.due_us, ticks_us()) < _CHECK_US:
            return
        self._settings_ms = ticks_add(ms, _SETTINGS_MS)
        self._revive(False)

    def _watch_imu(self, now):
        """A chip that answers but has no samples is set up again."""
        silent_us = ticks_diff(now, self.sampler.last_us)
        limit_us = _SILENT_PERIODS * self.sampler.clock.period_us
        if silent_us < (limit_us if limit_us > _SILENT_LEAST_US else _SILENT_LEAST_US):
            self.faults &= ~FAULT_IMU_SILENT
            self._failures = 0
            self._since_us = now
            return
        self.faults |= FAULT_IMU_SILENT
        if ticks_diff(now, self._check_us) < 0:
            return
        self._check_us = ticks_add(now, _SILENT_LEAST_US)
        always = ticks_diff(now, self._since_us) > _RECONFIGURE_US
        if always:
            self._since_us = now
        self._revive(always)

    # Everything that is not a sample.

    def _look_after(self, ms):
        if self.chip is not None:
            if not self._paused:
                self._watch_imu(ticks_us())
                if self.chip is not None and ticks_diff(ms, self._settings_ms) >= 0:
                    self._check_settings(ms)
        elif self._running and ticks_diff(ms, self._search_ms) >= _SEARCH_MS:
            self._search()
        if self.mag is not None and ticks_diff(ms, self._mag_ms) >= 0:
            self._read_mag(ms)
        if self.estimator is not None and ticks_diff(ms, self._filter_ms) >= 0:
            tracking = self.static.state == FILTER_STATE_TRACKING
            self._filter_ms = ticks_add(ms, self.settings["filter_period_ms"] if tracking else _HEALTH_MS)
            reports.filter_state(self)
        if ticks_diff(ms, self._health_ms) >= 0:
            self._health_ms = ticks_add(ms, _HEALTH_MS)
            reports.health(self)
            self.link.turn()
        if ticks_diff(ms, self._hello_ms) >= 0:
            self._hello_ms = ticks_add(ms, _HELLO_MS)
            reports.hello(self)

    def _read_mag(self, ms):
        words = self._mag_words
        self._mag_ms = ticks_add(ms, _MAG_RETRY_MS)
        if self._failures or self._paused:
            return
        try:
            if not self.mag.read_into(words, 0):
                self._mag_waits += 1
                if self._mag_waits * _MAG_RETRY_MS > _MAG_SILENT_MS:
                    self._mag_waits = 0
                    self.mag.configure()
                return
        except OSError:
            self.i2c_errors += 1
            return
        self._mag_waits = 0
        self._mag_ms = ticks_add(ms, 1000 // self.mag.rate_hz - _MAG_RETRY_MS)
        struct.pack_into(MAG_FORMAT, self.outbox.note(), PAYLOAD, ticks_us(), words[0], words[1], words[2])
        self.outbox.post(MAG, MAG_SIZE)

    def _idle(self, now):
        """Sleeps until shortly before the next sample is due, briefly, so that the host is heard."""
        wait = ticks_diff(self.sampler.due_us, now) - _MARGIN_US if self.chip is not None else _IDLE_US
        if wait > 0:
            sleep_us(wait if wait < _IDLE_US else _IDLE_US)


def _who_am_i(i2c, address, register):
    """The id that a chip at `address` answers with, or -1."""
    one = bytearray(1)
    try:
        i2c.readfrom_mem_into(address, register, one)
    except OSError:
        return -1
    return one[0]


def _nearest(choices, wanted):
    return min(choices, key=lambda value: abs(value - wanted))


def main():
    """Runs the node until it is told to leave; then restarts the board, or gives back the REPL.

    A watchdog cannot be stopped, and the REPL does not feed it: where one runs, the way to the REPL is a
    restart that finds the file STAY_IN_REPL.
    """
    try:
        os.remove(STAY_IN_REPL)
        return
    except OSError:
        pass
    board = Board(configuration.load())
    link = board.open_link()
    if not link.ON_CONSOLE:
        # Frames do not come this way: whoever sends ctrl-C means it.
        micropython.kbd_intr(_CTRL_C)
    try:
        mode = _run(board, link)
    except Exception as error:
        link.close()
        micropython.kbd_intr(_CTRL_C)
        sys.print_exception(error)
        _wait(board, _RESCUE_MS)
        machine.reset()
    link.close()
    micropython.kbd_intr(_CTRL_C)
    if mode == REBOOT_MODE_REPL:
        if not board.has_watchdog():
            return
        with open(STAY_IN_REPL, "w") as file:
            file.write("once")
    machine.reset()


def _run(board, link):
    node = Node(board, link)
    gc.collect()
    board.start_watchdog()
    while node.leave is None:
        node.turn()
    node.farewell()
    return node.leave


def _wait(board, ms):
    """Leaves time for ctrl-C before a restart that may fail in the same way."""
    for _ in range(ms // 10):
        sleep_ms(10)
        board.feed()
