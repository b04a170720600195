"""BMI088: gyro and accelerometer, two chips with addresses, FIFOs and clocks of their own (Bosch Sensortec).

chip = BMI088(i2c, odr_hz=200, range_dps=2000, range_g=24)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng

Samples are those of the gyro. Each carries the sample of the faster accelerometer that is nearest in time, as
the two are not synchronised: it is at most one period of the accelerometer away.
"""

import time
from time import ticks_add, ticks_diff, ticks_us

from micropython import const

from drivers.chip import Chip, find_setting, read_register

_CHIP_ID = const(0x00)
_SOFT_RESET = const(0xB6)

_ACC_X_LSB = const(0x12)
_TEMP_MSB = const(0x22)
_FIFO_LENGTH_0 = const(0x24)
_ACC_FIFO_DATA = const(0x26)
_ACC_CONF = const(0x40)
_ACC_RANGE = const(0x41)
_ACC_FIFO_CONFIG_0 = const(0x48)
_ACC_FIFO_CONFIG_1 = const(0x49)
_ACC_PWR_CONF = const(0x7C)
_ACC_PWR_CTRL = const(0x7D)
_ACC_CMD = const(0x7E)

_ACC_NORMAL = const(0xA0)
_ACC_STREAM = const(0x02)
_ACC_IN_FIFO = const(0x50)
_ACC_ON = const(0x04)
_FIFO_FLUSH = const(0xB0)
_FRAME = const(7)
_HEADER_MASK = const(0xFC)
_HEADER = const(0x84)
_FROM_GYRO = const(0x50)
"""Difference of the two addresses where SDO1 and SDO2 are tied to the same level."""

_RATE_X_LSB = const(0x02)
_FIFO_STATUS = const(0x0E)
_GYRO_RANGE = const(0x0F)
_GYRO_BANDWIDTH = const(0x10)
_GYRO_SOFTRESET = const(0x14)
_GYRO_FIFO_CONFIG_1 = const(0x3E)
_GYRO_FIFO_DATA = const(0x3F)

_ALWAYS_SET = const(0x80)
_STREAM = const(0x80)
_LEVEL = const(0x7F)
_SAMPLE = const(6)
_MEASURED_US = const(500000)


class _Accelerometer(Chip):
    """The accelerometer, whose FIFO has a byte before each sample."""

    WHO_AM_I_REGISTER = _CHIP_ID
    WHO_AM_I = (0x1E,)
    RESET = (_ACC_CMD, _SOFT_RESET, 2000)

    def __init__(self, i2c, address, odr_code, range_code):
        super().__init__(i2c, address)
        self._settings = (
            (_ACC_CONF, _ACC_NORMAL | odr_code),
            (_ACC_RANGE, range_code),
            (_ACC_FIFO_CONFIG_0, _ACC_STREAM),
            (_ACC_FIFO_CONFIG_1, _ACC_IN_FIFO),
        )
        power = ((_CHIP_ID, self.who_am_i), (_ACC_PWR_CONF, 0), (_ACC_PWR_CTRL, _ACC_ON))
        self._standing = power + self._settings
        self.pair = bytearray(2)

    def _after_reset(self):
        """Leave the suspend mode of a reset."""
        self.write(_ACC_PWR_CONF, 0)
        time.sleep_us(5000)
        self.write(_ACC_PWR_CTRL, _ACC_ON)
        time.sleep_us(50000)

    def read_pair(self, register):
        """Return two bytes, the first one low."""
        pair = self.pair
        self.i2c.readfrom_mem_into(self.address, register, pair)
        return pair[0] | pair[1] << 8


class BMI088(Chip):
    """Driver of the BMI088. fifo: use the FIFO at 200 Hz and below, too; above, always. wake_mg: ignored.

    Raises ValueError for a setting outside the tables, OSError when one of the two chips is absent.
    """

    PART = 0
    # (public value, actual rate in mHz, code, code and period in us of the accelerometer)
    RATES_HZ = (
        (100, 100000, 7, 9, 5000),
        (200, 200000, 6, 10, 2500),
        (400, 400000, 3, 11, 1250),
        (1000, 1000000, 2, 12, 625),
    )
    # (public value, scale in 1e-9 deg/s per step, code)
    RANGES_DPS = (
        (125, 3814697, 4),
        (250, 7629395, 3),
        (500, 15258789, 2),
        (1000, 30517578, 1),
        (2000, 61035156, 0),
    )
    RANGES_G = ((3, 91553, 0), (6, 183105, 1), (12, 366211, 2), (24, 732422, 3))
    RESET = (_GYRO_SOFTRESET, _SOFT_RESET, 30000)
    FIFO_SAMPLES = 72
    """Samples for which both FIFOs have room: 1024 bytes of the accelerometer, which is twice as fast."""
    WHO_AM_I_REGISTER = _CHIP_ID
    WHO_AM_I = (0x0F,)
    clock = None
    """The sample clock of the node, which has the time of the newest sample; None: it is estimated."""

    @classmethod
    def probe(cls, i2c, address):
        """Return the identity of the gyro if the accelerometer answers, too, else -1; only reads."""
        accel = read_register(i2c, address - _FROM_GYRO, _CHIP_ID)
        return super().probe(i2c, address) if accel in _Accelerometer.WHO_AM_I else -1

    def __init__(self, i2c, address=0x68, *, odr_hz=200, range_dps=2000, range_g=24, fifo=False, wake_mg=0):
        odr, self.rate_mhz, odr_code, accel_odr_code, self._accel_us = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = find_setting(self.RANGES_G, range_g)
        self.temperature_lsb_udegc = 125000
        self.temperature_offset_udegc = 23000000
        super().__init__(i2c, address)
        self._accel = _Accelerometer(i2c, address - _FROM_GYRO, accel_odr_code, accel_code)
        self.uses_fifo = fifo or odr > 200
        self.temperature_raw = self.realigned = 0
        self.was_running = self._accel.read(_ACC_PWR_CTRL) != 0
        """True if it was already running: after power-on the accelerometer is off."""
        self._settings = (
            (_GYRO_RANGE, gyro_code),
            (_GYRO_BANDWIDTH, _ALWAYS_SET | odr_code),
            (_GYRO_FIFO_CONFIG_1, _STREAM),
        )
        self._standing = ((_CHIP_ID, self.who_am_i),) + self._settings
        self._period_us = 1000000000 // self.rate_mhz
        self._sample = bytearray(_SAMPLE)
        frames = bytearray(32 * _FRAME)
        self._frames = frames
        # A buffer for each number of frames in a transfer, as a slice in the loop would allocate.
        self._transfers = tuple((n, memoryview(frames)[: n * _FRAME]) for n in (32, 16, 8, 4, 2, 1))
        self._level = self._row = self._used = 0
        self._polled_us = self._mark_us = ticks_us()
        """_used: samples of the accelerometer that were read since `_mark_us`."""
        self.shape(1)
        self.configure()

    def configure(self, *, reset=True):
        """Reset both chips, unless they are to sample on, and write every setting; sampling starts."""
        self._accel.i2c = self.i2c
        self._accel.configure(reset=reset)
        super().configure(reset=reset)

    def intact(self):
        """Return True while WHO_AM_I and settings persist in both chips: a supply dip resets them."""
        self._accel.i2c = self.i2c
        return super().intact() and self._accel.intact()

    def shape(self, batch):
        """Set the number of samples that `fifo_read_into` reads."""
        self._gyro = bytearray(batch * _SAMPLE)

    def ready(self):
        """Return the number of new samples, those in the FIFO: the flag of one clears itself after 0.3 ms."""
        return self.read(_FIFO_STATUS) & _LEVEL

    def read_into(self, words, at):
        """Read a sample of six words to words[at]; return 0 if there is no new one, else 1."""
        level = self.ready()
        if not level:
            return 0
        raw = self._sample
        self.i2c.readfrom_mem_into(self.address, _GYRO_FIFO_DATA if level == 1 else _RATE_X_LSB, raw)
        if level > 1:
            # Samples before the newest one are overdue.
            self.write(_GYRO_FIFO_CONFIG_1, _STREAM)
        for i in range(3):
            words[at + i] = _signed(raw[2 * i] | raw[2 * i + 1] << 8)
        self.i2c.readfrom_mem_into(self._accel.address, _ACC_X_LSB, raw)
        for i in range(3):
            words[at + 3 + i] = _signed(raw[2 * i] | raw[2 * i + 1] << 8)
        return 1

    def fifo_level(self):
        """Return the number of samples in the FIFO; -1 if it, or that of the accelerometer, may be full."""
        level = self.read(_FIFO_STATUS)
        self._polled_us = ticks_us()
        self._level = level
        return level if level <= self.FIFO_SAMPLES else -1

    def fifo_read_into(self, rows):
        """Read len(rows) / 12 samples of the gyro, and the sample of the accelerometer nearest to each.

        Return True if there are none of the accelerometer, or something else in its FIFO.
        """
        held = self._accel.read_pair(_FIFO_LENGTH_0) // _FRAME
        now = ticks_us()
        self._measure_period(now, held)
        newest_us = ticks_add(now, -(self._accel_us >> 1))
        raw, at = self._gyro, 0
        self.i2c.readfrom_mem_into(self.address, _GYRO_FIFO_DATA, raw)
        for to in range(0, len(rows), 12):
            for i in range(_SAMPLE):
                rows[to + i] = raw[at + i]
            at += _SAMPLE
        last = self._nearest(len(rows) // 12 - 1, newest_us, held)
        self._row = 0
        done = 0
        for n, transfer in self._transfers:
            while last + 1 - done >= n:
                self.i2c.readfrom_mem_into(self._accel.address, _ACC_FIFO_DATA, transfer)
                if self._copy(rows, done, n, newest_us, held):
                    return True
                done += n
        self._used += done
        self._level -= len(rows) // 12
        return not held

    def _measure_period(self, now, held):
        """Measure the period of the accelerometer by its samples of half a second."""
        span_us, samples = ticks_diff(now, self._mark_us), self._used + held
        if span_us > _MEASURED_US:
            if abs(span_us - samples * self._accel_us) < span_us >> 3:
                self._accel_us = span_us // samples
            self._mark_us, self._used = now, -held

    def _copy(self, rows, first, n, newest_us, held):
        """Copy to the rows what is nearest to them of `n` frames from the number `first` on."""
        frames, row = self._frames, self._row
        for k in range(n):
            at = k * _FRAME
            if frames[at] & _HEADER_MASK != _HEADER:
                return True
            while 12 * row < len(rows) and self._nearest(row, newest_us, held) <= first + k:
                to = 12 * row + 5
                for i in range(1, _FRAME):
                    rows[to + i] = frames[at + i]
                row += 1
        self._row = row
        return False

    def _nearest(self, row, newest_us, held):
        """Return the number of the frame nearest to a row; newest_us: time of the newest of `held`."""
        period_us, at_us = self._period_us, ticks_add(self._polled_us, -(self._period_us >> 1))
        if self.clock is not None:
            period_us, at_us = self.clock.period_us, self.clock.t_us
        age_us = ticks_diff(newest_us, at_us) + (self._level - 1 - row) * period_us
        number = held - 1 - (age_us + (self._accel_us >> 1)) // self._accel_us
        return min(max(number, 0), held - 1)

    def fifo_flush(self):
        """Flush both FIFOs and restart them at a whole sample."""
        self._accel.write(_ACC_CMD, _FIFO_FLUSH)
        self._mark_us, self._used = ticks_us(), 0
        self.write(_GYRO_FIFO_CONFIG_1, _STREAM)

    def read_temperature(self):
        """Update `temperature_raw`, which samples do not contain; 11 bits, the high ones first."""
        self._accel.read_pair(_TEMP_MSB)
        pair = self._accel.pair
        self.temperature_raw = _signed(pair[0] << 8 | pair[1]) >> 5


def _signed(value):
    return value - 65536 if value & 0x8000 else value
