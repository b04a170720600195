"""Sleep while the vehicle is parked: the IMU waits for motion, the processor is in `machine.lightsleep`.

The IMU samples at `rest_rate_hz` in its low-power modes, into its FIFO, which overwrites its oldest samples.
Its motion detector, latched on INT1, ends the sleep; the newest samples of the FIFO are sent, so the motion
that woke the node is among them. The FIFO is read to its end before each change of the rate.

`lightsleep` of the rp2 port (MicroPython 1.24 to 1.28) ends with its time, or early at an edge of a pin that
has a handler; ticks go on. A watchdog that expires in it can lock up an RP2040, so it lasts less than that.
On an ESP32 it ends early at the level of the pin of `esp32.wake_on_ext0`; an RC oscillator keeps the time.
"""

import sys
from time import sleep_us, ticks_add, ticks_diff, ticks_ms, ticks_us

import machine
import reports
from drivers.chip import nearest
from drivers.st_asleep import halt, halt_magnetometer, parking_settings, recover_fifo
from micropython import const
from outbox import ROW
from slow_sampling import SlowSampling
from wire import BATCH_FLAG_RATE_CHANGED, FAULT_ASLEEP, GET_HELLO, PING, TIME_REQUEST

_REPORT_MS = const(4000)
"""Interval of Health; half of the watchdog's time."""
_DETECTOR_MS = const(100)
"""Without a wire from INT1 the motion detector is read at this interval."""
_HISTORY = const(120)
"""Samples from before the end of the sleep: at 26 Hz those since the last report of a node at rest."""
_BATCH = const(16)
_MOST_POLLS = const(1000)
_POLL_US = const(100)
_CHANGE_US = const(10000)
"""Time for a change of the rate, before the next sample at the slow one."""
_HARMLESS = (TIME_REQUEST, PING, GET_HELLO)
"""Requests that a node answers without an end of its sleep."""


def _wake_pin(number):
    """Return the pin that ends a sleep when INT1 rises; None where the port cannot do that with this pin."""
    pin = machine.Pin(number, machine.Pin.IN, machine.Pin.PULL_DOWN)
    if sys.platform != "esp32":
        pin.irq(_ignore, machine.Pin.IRQ_RISING)
        return pin
    try:
        import esp32

        esp32.wake_on_ext0(pin, esp32.WAKEUP_ANY_HIGH)
    except (AttributeError, ValueError):
        # A C3 lacks the function, and the others accept the pins of their RTC alone.
        return None
    return pin


def _ignore(pin):
    """Handle the edge of a pin: nothing to do, but without a handler it ends no sleep."""


class Parking(SlowSampling):
    """Puts the node to sleep after `park_after_s` at standstill; its interface is that of `SlowSampling`."""

    def __init__(self, node):
        super().__init__(node)
        self._after_ms = 1000 * node.settings["park_after_s"]
        self._pin = None
        self._words = [0] * ROW
        number = node.board.pins.get("wake", -1)
        if number >= 0:
            self._pin = _wake_pin(number)

    def use(self, values, first, count):
        """Check a batch at full rate for motion."""
        if not self.is_slow:
            super().use(values, first, count)

    def step(self, ms):
        """Go to sleep if that is due; return at full rate, after the first motion."""
        node = self._node
        chip = node.parts.chip
        if chip is None or node.parts.paused:
            return
        if self._in_motion:
            self._in_motion = False
            self._since_ms = ms
        elif self._is_still(ms):
            if chip.MOTION_FLAG and chip.uses_fifo and node.sampler.clock.locked:
                self._park(chip)
            self._still_ms, self._since_ms = 0, ticks_ms()

    def _park(self, chip):
        """Sleep until the chip detects motion, or a request or a fault ends the sleep."""
        node, parts, sampler = self._node, self._node.parts, self._node.sampler
        mag, s, is_request = parts.mag, node.settings, False
        asleep, awake = parking_settings(chip)
        self.is_slow = True
        parts.faults |= FAULT_ASLEEP
        try:
            halt(chip)
            chip.read_temperature()
            self._read_rest(chip, sampler.reader.left)
            slow = self._reopen(chip, s["rest_rate_hz"], chip.RANGES_G[0][0], s["rest_mg"], asleep)
            if mag is not None:
                halt_magnetometer(mag)
            reports.hello(node)
            is_request = self._sleep(slow)
            sampler.flags = BATCH_FLAG_RATE_CHANGED
            self._wake(slow, chip.rate_mhz)
            self._reopen(slow, s["rate_hz"], chip.range_g, 0, awake)
            parts.start(False)
            sampler.flags = BATCH_FLAG_RATE_CHANGED
            # At once, as the start discards what the chip has sampled by then.
            sampler.step(ticks_us())
            if mag is not None:
                mag.configure()
        except OSError:
            # Supervision searches for the chip.
            parts.i2c_errors += 1
            parts.chip = None
            sampler.end()
        self.is_slow = False
        parts.faults &= ~FAULT_ASLEEP
        node.outbox.shape(parts.batch)
        node.restart_duties()
        reports.hello(node)
        reports.health(node)
        if is_request:
            node.commands.handle(node.link.reader, ticks_us())

    def _reopen(self, chip, rate_hz, range_g, wake_mg, settings):
        """Configure the chip with another rate and range, and its FIFO; return its new driver."""
        self._node.parts.chip = driver = type(chip)(
            chip.i2c,
            chip.address,
            odr_hz=nearest(chip.RATES_HZ, rate_hz)[0],
            range_dps=chip.range_dps,
            range_g=range_g,
            fifo=True,
            wake_mg=wake_mg,
            settings=settings,
        )
        return driver

    def _sleep(self, chip):
        """Sleep until motion; return True if a request ended the sleep that has yet to be executed."""
        node = self._node
        link, report_ms = node.link, ticks_ms()
        self._await_sample(chip, 0)
        # The change of the range is a step of the acceleration, too.
        self._motion_detected(chip)
        chip.read_into(self._words, 0)
        self._compare(self._words, 0)
        while True:
            ms = ticks_ms()
            node.board.feed()
            if self._pin is not None and self._pin.value():
                return False
            if ticks_diff(ms, report_ms) >= 0:
                report_ms = ticks_add(ms, _REPORT_MS)
                if not chip.intact() or self._motion_detected(chip) or self._has_turned(chip):
                    return False
                for warm in node.warm:
                    while warm.step(ms):
                        node.drift(warm)
                reports.health(node)
            elif self._pin is None and self._motion_detected(chip):
                return False
            node.farewell()
            while link.receive():
                if link.reader.type_id not in _HARMLESS:
                    return True
                node.commands.handle(link.reader, ticks_us())
                node.farewell()
            left = ticks_diff(report_ms, ticks_ms())
            link.sleep(left if self._pin is not None or left < _DETECTOR_MS else _DETECTOR_MS)

    def _has_turned(self, chip):
        """Return True if a new sample differs from the last: slow motion does not trigger the detector."""
        self._in_motion = False
        if chip.read_into(self._words, 0):
            self._compare(self._words, 0)
        return self._in_motion

    def _wake(self, chip, full_rate_mhz):
        """Send the newest samples of the FIFO, up to one that has just been taken."""
        clock = self._node.sampler.clock
        # One oscillator sets both rates, so the ratio of their periods is exact.
        period_ns = clock.period_ns * full_rate_mhz // chip.rate_mhz
        level = recover_fifo(chip)
        # A full FIFO would overwrite samples while they are read.
        history = min(_HISTORY, chip.FIFO_SAMPLES - _BATCH)
        while level > history:
            count = min(level - history, _BATCH)
            self._fill(chip, count)
            level -= count
        level = chip.fifo_level()
        clock.start(period_ns)
        clock.t_us = ticks_add(self._await_sample(chip, level), -(level + 1) * clock.period_us)
        self._read_rest(chip, 0)
        if ticks_diff(ticks_us(), clock.t_us) > clock.period_us - _CHANGE_US:
            # A sample during the change of the rate would be lost.
            self._await_sample(chip, 0)
            self._read_rest(chip, 0)

    def _await_sample(self, chip, level):
        """Wait until the FIFO holds more than `level` samples; return the time."""
        for _ in range(_MOST_POLLS):
            if chip.fifo_level() > level:
                break
            sleep_us(_POLL_US)
        return ticks_us()

    def _read_rest(self, chip, counted):
        """Send all samples in the FIFO; the sample clock has already counted the first `counted` of them."""
        sampler = self._node.sampler
        clock, level = sampler.clock, chip.fifo_level()
        at, sampler.chip = 1 - counted, chip
        while level > 0:
            count = min(level, _BATCH)
            self._fill(chip, count)
            sampler.open_batch(clock.ahead_us(at), clock.index + at)
            sampler.count = count
            sampler.flush()
            at += count
            level = level - count or chip.fifo_level()
        clock.t_us, clock.index = clock.ahead_us(at - 1), clock.index + at - 1
        sampler.end()

    def _fill(self, chip, count):
        """Read `count` samples from the FIFO into the open batch."""
        slot = self._node.sampler.slot
        slot.shape(count)
        chip.shape(count)
        chip.fifo_read_into(slot.rows)
