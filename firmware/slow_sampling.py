"""Sample slowly at standstill, and at the full rate again within two slow samples of a motion.

Standstill: for `rest_after_s` no sample differs from a reference sample. A wheel that rolls evenly rotates
gravity, so it does not qualify. The motion detector of the chip, if any, senses jolts between two samples.
"""

from time import ticks_add, ticks_diff, ticks_ms

import reports
from drivers.chip import nearest
from micropython import const
from outbox import FIRST_ROW, ROW
from wire import BATCH_FLAG_RATE_CHANGED

_GYRO = const(3)
_COUNT_MS = const(1000)


class SlowSampling:
    """Switches between two sample rates. Call `use` with each batch, `step` every 20 ms."""

    def __init__(self, node):
        self._node = node
        self.is_slow = False
        self._after_ms = 1000 * node.settings["rest_after_s"]
        self._reference = [0] * ROW
        self._still_ms = 0
        self._since_ms = ticks_ms()
        self._compared = 0
        self._in_motion = False

    def use(self, values, first, count):
        """Check a batch for motion: two of its samples at full rate, all at the slow rate."""
        if self.is_slow:
            at = first + ROW * self._compared
            while at < first + ROW * count:
                self._compare(values, at)
                at += ROW
            self._compared = 0
            return
        self._compare(values, first + ROW * (count - 1))
        self._compare(values, first + ROW * (count >> 1))

    def step(self, ms):
        """Change the rate if that is due."""
        node = self._node
        chip = node.parts.chip
        if chip is None or node.parts.paused:
            return
        if self.is_slow:
            sampler = node.sampler
            while self._compared < sampler.count:
                self._compare(sampler.slot.values, FIRST_ROW + ROW * self._compared)
                self._compared += 1
            if self._in_motion or self._motion_detected(chip):
                self._change(chip, False)
        elif self._in_motion:
            self._in_motion = False
            self._since_ms = ms
        elif self._is_still(ms):
            self._change(chip, True)

    def _is_still(self, ms):
        """Return True after `rest_after_s` at standstill, counted in seconds as ticks wrap around."""
        passed = ticks_diff(ms, self._since_ms)
        if passed >= _COUNT_MS:
            self._since_ms = ticks_add(self._since_ms, _COUNT_MS)
            self._still_ms += _COUNT_MS
        return self._still_ms + ticks_diff(ms, self._since_ms) >= self._after_ms

    def _compare(self, values, at):
        """Compare a sample with the reference; one that differs is motion and the new reference."""
        reference, chip, s = self._reference, self._node.parts.chip, self._node.settings
        # Within small integers, as larger ones would be allocated.
        gyro = s["rest_dps"] * 1000000 // (chip.gyro_lsb_ndps // 1000)
        accel = s["rest_mg"] * 1000000 // chip.accel_lsb_ng
        for i in range(ROW):
            if abs(values[at + i] - reference[i]) > (gyro if i < _GYRO else accel):
                self._in_motion = True
                self._still_ms = 0
                for k in range(ROW):
                    reference[k] = values[at + k]
                return

    def _motion_detected(self, chip):
        """Return True if the motion detector of the chip has triggered since the last call."""
        flag = chip.MOTION_FLAG
        if not flag:
            return False
        try:
            return bool(chip.read(flag[0]) & flag[1])
        except OSError:
            return False

    def _change(self, chip, is_slow):
        """Configure the chip with the other rate; Hello reports it, the next batch carries a flag."""
        node = self._node
        parts, s = node.parts, node.settings
        node.sampler.end()
        parts.chip = type(chip)(
            chip.i2c,
            chip.address,
            odr_hz=nearest(chip.RATES_HZ, s["rest_rate_hz"] if is_slow else s["rate_hz"])[0],
            range_dps=chip.range_dps,
            range_g=chip.range_g,
            fifo=not is_slow and s["fifo"],
            wake_mg=s["rest_mg"] if is_slow else 0,
        )
        parts.start(False)
        node.sampler.flags = BATCH_FLAG_RATE_CHANGED
        self.is_slow = is_slow
        self._in_motion = False
        self._compared = self._still_ms = 0
        self._since_ms = ticks_ms()
        reports.hello(node)
