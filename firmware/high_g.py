"""A node with an accelerometer beyond the range of its IMU; loaded where `high_g_rate_hz` asks for one."""

import struct
from time import ticks_add, ticks_diff, ticks_us

import reports
from drivers.adxl375 import ADXL375
from drivers.chip import acknowledges, nearest
from framing import PAYLOAD
from micropython import const
from node import Node
from wire import CRC_SIZE
from wire_more import HIGH_G, HIGH_G_FORMAT, HIGH_G_ROW_SIZE, HIGH_G_SIZE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_ADDRESSES = (0x53, 0x1D)
_BATCH = const(16)
_FULL = const(32)
_MEASURED_US = const(500000)
_CHECK_INTERVAL_US = const(1000000)


class HighGNode(Node):
    """A node that also sends the samples of an ADXL375, in messages of up to 16.

    A chip that is missing, or lost its settings, is searched once a second.
    """

    def __init__(self, board, link):
        self._high_g: Any = None
        self._high_us = self._span_us = self._stamp_us = ticks_us()
        self._period_ns = self._counted = 0
        self._due_us = _MEASURED_US
        super().__init__(board, link)

    def start(self):
        """Search for all chips and start sampling."""
        super().start()
        self._open()

    def _open(self):
        i2c, rate_hz = self.board.i2c, self.settings["high_g_rate_hz"]
        self._high_us = ticks_us()
        for address in _ADDRESSES:
            try:
                if acknowledges(i2c, address):
                    chip = ADXL375(i2c, address, odr_hz=nearest(ADXL375.RATES_HZ, rate_hz)[0])
                    self._period_ns = 1000000000 // chip.rate_hz
                    self._span_us, self._counted, self._due_us = self._high_us, 0, _MEASURED_US
                    if self._high_g is None:
                        self.parts.chips.append((address, chip.who_am_i, 0))
                        reports.hello(self)
                    self._high_g = chip
                    return
            except OSError:
                self.parts.i2c_errors += 1

    def _duties(self, ms):
        super()._duties(ms)
        if not self._running or self.parts.paused or self.parts.failures:
            return
        now, chip = ticks_us(), self._high_g
        if ticks_diff(now, self._high_us) >= _CHECK_INTERVAL_US:
            self._high_us = now
            try:
                if chip is None or not chip.intact():
                    self._open()
            except OSError:
                self.parts.i2c_errors += 1
        elif chip is not None:
            try:
                self._read(chip)
            except OSError:
                self.parts.i2c_errors += 1

    def _read(self, chip):
        """Queue the samples that wait, if they are enough for a message."""
        level, now = chip.level(), ticks_us()
        if level < _BATCH:
            return
        self._measure_period(level, now)
        raw = self.outbox.note()
        count = min(level, (len(raw) - PAYLOAD - HIGH_G_SIZE - CRC_SIZE - 1) // HIGH_G_ROW_SIZE, _BATCH)
        stamp_us = self._stamp(level, count, now)
        struct.pack_into(HIGH_G_FORMAT, raw, PAYLOAD, stamp_us, self._period_ns, chip.LSB_NG, count)
        at = PAYLOAD + HIGH_G_SIZE
        for _ in range(count):
            chip.read_into(raw, at)
            at += HIGH_G_ROW_SIZE
        self._counted += count
        self.outbox.post(HIGH_G, at - PAYLOAD)

    def _stamp(self, level, count, now):
        """Return the time of the last of the `count` oldest samples of `level`.

        The newest sample is half a period old on average; an eighth of the deviation corrects the clock.
        """
        period_us = self._period_ns // 1000
        measured_us = ticks_add(now, -((level - count) * 2 + 1) * (period_us >> 1))
        stamp_us = ticks_add(self._stamp_us, count * self._period_ns // 1000)
        error_us = ticks_diff(measured_us, stamp_us)
        if abs(error_us) > 2 * period_us:
            # The first samples, or some were lost.
            stamp_us = measured_us
        else:
            stamp_us = ticks_add(stamp_us, error_us >> 3)
        self._stamp_us = stamp_us
        return stamp_us

    def _measure_period(self, level, now):
        """Measure the period by the samples of 0.5, 1, 2, 4 and then of 8 s each, unless some were lost."""
        span_us, samples = ticks_diff(now, self._span_us), self._counted + level
        if level >= _FULL:
            self._span_us, self._counted, self._due_us = now, -level, _MEASURED_US
        elif span_us >= self._due_us and samples > _BATCH:
            # In two steps, within small integers.
            period_ns = span_us // samples * 1000 + span_us % samples * 1000 // samples
            nominal_ns = 1000000000 // self._high_g.rate_hz
            if abs(period_ns - nominal_ns) < nominal_ns >> 3:
                self._period_ns = period_ns
            if self._due_us < _MEASURED_US << 4:
                self._due_us <<= 1
            else:
                self._span_us, self._counted = now, -level
