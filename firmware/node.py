"""The node: assembly of its parts, the main loop, start and shutdown."""

import gc
import os
import struct
import sys
from time import sleep_ms, sleep_us, ticks_add, ticks_diff, ticks_ms, ticks_us

import bias_choice
import machine
import micropython
import reports
from bias_initialiser import BiasInitialiser
from board import Hardware
from buffers import shared
from commands import Commands
from framing import PAYLOAD
from micropython import const
from outbox import Outbox
from parts import Parts
from sampler import Sampler
from wire import (
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

STAY_IN_REPL = "/stay_in_repl"

_N_AXES = const(3)
_HELLO_MS = const(5000)
_HEALTH_MS = const(1000)
_QUIET_START_MS = const(200)
_DUTY_MS = const(20)
_MIN_SLEEP_US = const(1000)
_WAKE_EARLY_US = const(100)
_MAG_RETRY_MS = const(5)
_MAG_SILENT_MS = const(1000)
_CTRL_C = const(3)
_FAREWELL_MS = const(300)
_CTRL_C_WAIT_MS = const(3000)


class Node:
    """One node on one board. `step` runs the loop once; `leave` is set to a RebootMode when it must end."""

    def __init__(self, board, link):
        self.board = board
        self.link = link
        self.settings = board.settings
        self.outbox = Outbox(self.settings["queue"], self.settings["node_id"])
        self.sampler = Sampler(self.outbox, self._batch_done)
        self.parts = Parts(board, self.outbox, self.sampler, self._on_search)
        self.commands = Commands(self)
        self.leave = None
        self.slow: Any = None
        """Reduces the sample rate at standstill, where the settings ask for that."""
        self.estimator: Any = None
        self.init: Any = BiasInitialiser()
        """The bias at the start. A subclass that estimates it is loaded when `BiasInit` is requested."""
        self.warm: Any = ()
        self._running = True
        self._next_index = self._lsb_ndps = 0
        self.longest_us = self._mag_waits = 0
        _, self._mag_words = shared(3)
        self.restart_duties()
        self.new_filter()
        self.start()

    def restart_duties(self):
        """Make all periodic duties due in 0.2 s; until then sampling locks its clock undisturbed."""
        self._duty_ms = ticks_add(ticks_ms(), _QUIET_START_MS)
        self._hello_ms = self._health_ms = self._filter_ms = self._mag_ms = self._duty_ms

    def step(self):
        """Run the loop once: sample, send, receive, then the periodic duties."""
        now = ticks_us()
        if not self.parts.paused:
            try:
                self.sampler.step(now)
            except OSError as error:
                self.parts.handle_bus_error(error, ticks_us())
        if self.outbox.count:
            self.link.send(self.outbox)
        if self.link.receive():
            self.commands.handle(self.link.reader, ticks_us())
            # The answer is sent at once: the host would take a delay here for transmission time.
            self.link.send(self.outbox)
        ms = ticks_ms()
        if ticks_diff(ms, self._duty_ms) >= 0:
            self._duty_ms = ticks_add(ms, _DUTY_MS)
            self._duties(ms)
        done = ticks_us()
        took = ticks_diff(done, now)
        if took > self.longest_us:
            self.longest_us = took
        self._idle(done)

    def start(self):
        """Search for the chips, configure them and start sampling; without an IMU `parts.chip` is None."""
        self._running = True
        self.parts.find()
        if self.parts.chip is None:
            self.sampler.end()
        else:
            self._set_bias()
            # Before sampling starts, as the clock of the samples needs its first poll at once.
            gc.collect()
            self.parts.start(False)
        self.free_heap = gc.mem_free()
        """bytes; measured here alone, as that walks the heap. Nothing is allocated from here on."""
        reports.hello(self)

    def stop(self):
        """Stop sampling; requests are still answered."""
        self._running = False
        self.sampler.end()
        self.parts.chip = None
        self.commands.bias_given_up()

    def new_init(self):
        """Create the bias initialiser that the settings ask for; it inherits the present bias."""
        before = self.init
        self.init = bias_choice.initialisation(self.settings, self.sampler.clock)
        self.init.adopt(before)

    def new_filter(self):
        """Create the estimator that the settings ask for, with rate zero and the present bias."""
        self.estimator = bias_choice.estimator(self.settings)
        self._reset_filter()

    def farewell(self):
        """Give the link up to 0.3 s to send the frames in the queue."""
        until = ticks_add(ticks_ms(), _FAREWELL_MS)
        while self.outbox.count and ticks_diff(until, ticks_ms()) > 0:
            self.link.send(self.outbox)
            self.board.feed()
            sleep_ms(1)

    # Samples and gyro bias.

    def _batch_done(self, values, first, count):
        """Pass a batch to bias initialiser, estimator and standstill detector before it is sealed."""
        init, estimator = self.init, self.estimator
        index = self.sampler.first_index
        if index != self._next_index:
            init.gap()
        self._next_index = index + count
        if init.state == FILTER_STATE_INITIALISING:
            if init.update(values, first, count):
                self._reset_filter()
                self.commands.bias_done(init.refused)
        elif init.state == FILTER_STATE_TRACKING and estimator is not None:
            estimator.update(values, first, count)
        if self.slow is not None:
            self.slow.use(values, first, count)

    def _reset_filter(self):
        if self.estimator is not None:
            for axis in range(_N_AXES):
                self.estimator.reset(axis, self.init.now_q14(axis))

    def _set_bias(self):
        """Convert the bias of the settings to steps of the chip; once per scale."""
        s, chip = self.settings, self.parts.chip
        if chip.gyro_lsb_ndps == self._lsb_ndps:
            return
        self._lsb_ndps = chip.gyro_lsb_ndps
        self.warm = bias_choice.warm_up(s, chip, self.parts.was_running)
        for axis in range(_N_AXES):
            known = bias_choice.known_bias_q18(s, axis, chip)
            if known is not None:
                for warm in self.warm:
                    known += warm.drift_q18(axis)
                self.init.give(axis, known >> 4)
        self._reset_filter()

    def drift(self, warm):
        """Apply a step of a warm-up to the estimator and to the bias for the next one."""
        for axis in range(_N_AXES):
            step_q18 = warm.step_q18[axis]
            self.init.drift(axis, step_q18)
            if self.estimator is not None:
                self.estimator.drift(axis, step_q18)

    # Periodic duties.

    def _duties(self, ms):
        self.board.feed()
        self.parts.supervise(ms, self._running)
        if self.slow is not None:
            self.slow.step(ms)
        if self.parts.mag is not None:
            if ticks_diff(ms, self._mag_ms) >= 0:
                self._read_mag(ms)
            if ticks_diff(self._mag_ms, self._duty_ms) < 0:
                self._duty_ms = self._mag_ms
        for warm in self.warm:
            while warm.step(ms):
                self.drift(warm)
        if self.estimator is not None and ticks_diff(ms, self._filter_ms) >= 0:
            tracking = self.init.state == FILTER_STATE_TRACKING
            self._filter_ms = ticks_add(ms, self.settings["filter_period_ms"] if tracking else _HEALTH_MS)
            reports.filter_state(self)
        if ticks_diff(ms, self._health_ms) >= 0:
            self._health_ms = ticks_add(ms, _HEALTH_MS)
            reports.health(self)
            self.link.step()
        if ticks_diff(ms, self._hello_ms) >= 0:
            self._hello_ms = ticks_add(ms, _HELLO_MS)
            reports.hello(self)

    def _on_search(self):
        if self.parts.chip is not None:
            self._set_bias()
        reports.hello(self)

    def _read_mag(self, ms):
        words, mag = self._mag_words, self.parts.mag
        self._mag_ms = ticks_add(ms, _MAG_RETRY_MS)
        if self.parts.failures or self.parts.paused:
            return
        try:
            if not mag.read_into(words, 0):
                self._mag_waits += 1
                if self._mag_waits * _MAG_RETRY_MS > _MAG_SILENT_MS:
                    self._mag_waits = 0
                    mag.configure()
                return
        except OSError:
            self.parts.i2c_errors += 1
            return
        self._mag_waits = 0
        self._mag_ms = ticks_add(ms, 1000 // mag.rate_hz - _MAG_RETRY_MS)
        struct.pack_into(MAG_FORMAT, self.outbox.note(), PAYLOAD, ticks_us(), words[0], words[1], words[2])
        self.outbox.post(MAG, MAG_SIZE)

    def _idle(self, now):
        """Sleep until shortly before the next duty; bytes from the host end the sleep."""
        wait = 1000 * ticks_diff(self._duty_ms, ticks_ms())
        if self.parts.chip is not None and not self.parts.paused:
            due = ticks_diff(self.sampler.due_us, now) - _WAKE_EARLY_US
            wait = due if due < wait else wait
        if wait >= _MIN_SLEEP_US:
            self.link.wait(1 if self.outbox.count else wait // _MIN_SLEEP_US)
        elif wait > 0:
            sleep_us(wait)


def main(*trial):
    """Run the node until a request ends it; then restart the board or return to the REPL.

    trial: path of the settings at the first start after an update over the air, see `radio/trial.py`.

    A watchdog cannot be stopped, and the REPL does not feed it: with a watchdog the REPL is reached by a
    restart that finds the file STAY_IN_REPL. After power-on that file is removed and ignored.
    """
    try:
        # The removal of a missing file would check the whole file system, in 0.05 s.
        os.stat(STAY_IN_REPL)
        os.remove(STAY_IN_REPL)
        if machine.reset_cause() != machine.PWRON_RESET:
            return
    except OSError:
        pass
    # The table of settings is loaded for a moment, as its names cost heap.
    import settings

    board = Hardware(settings.load(*trial))
    del sys.modules["settings"], settings
    link = board.open_link()
    if not link.ON_CONSOLE:
        # No frames arrive on the console: a ctrl-C there is a user's.
        micropython.kbd_intr(_CTRL_C)
    try:
        mode = _run(board, link, trial)
    except Exception as error:
        link.close()
        micropython.kbd_intr(_CTRL_C)
        sys.print_exception(error)
        _wait(board, _CTRL_C_WAIT_MS)
        machine.reset()
    link.close()
    micropython.kbd_intr(_CTRL_C)
    if mode == REBOOT_MODE_REPL:
        if not board.has_watchdog():
            return
        with open(STAY_IN_REPL, "w") as file:
            file.write("once")
    machine.reset()


def _run(board, link, trial):
    # The file of rare choices delays Hello, so it is loaded only where one of them may be set.
    if "receiver" in board.settings:
        import node_choice

        node = node_choice.create(board, link)
        del sys.modules["node_choice"], node_choice
    else:
        node = Node(board, link)
    if trial:
        from radio.trial import Trial

        Trial(node)
    board.start_watchdog(trial)
    while node.leave is None:
        node.step()
    node.farewell()
    return node.leave


def _wait(board, ms):
    """Wait, so that a user can press ctrl-C before a restart that may fail in the same way."""
    for _ in range(ms // 10):
        sleep_ms(10)
        board.feed()
