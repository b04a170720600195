"""BMI270: gyro and accelerometer that need a configuration of 8 kB after each reset (Bosch Sensortec).

chip = BMI270(i2c, odr_hz=200, range_dps=2000, range_g=16)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng

The configuration is Bosch's `bmi270_config_file` (BSD-3-Clause, in its BMI270 Sensor API), which is not part
of this firmware: its 8192 bytes are read from the file CONFIGURATION on the board.
"""

import os
import time

from micropython import const

from drivers.chip import Chip, find_setting

CONFIGURATION = "/bmi270.bin"

_CHIP_ID = const(0x00)
_STATUS = const(0x03)
_ACC_X_LSB = const(0x0C)
_INTERNAL_STATUS = const(0x21)
_TEMPERATURE_0 = const(0x22)
_FIFO_LENGTH_0 = const(0x24)
_FIFO_DATA = const(0x26)
_ACC_CONF = const(0x40)
_ACC_RANGE = const(0x41)
_GYR_CONF = const(0x42)
_GYR_RANGE = const(0x43)
_FIFO_CONFIG_0 = const(0x48)
_FIFO_CONFIG_1 = const(0x49)
_INIT_CTRL = const(0x59)
_INIT_ADDR_0 = const(0x5B)
_INIT_DATA = const(0x5E)
_PWR_CONF = const(0x7C)
_PWR_CTRL = const(0x7D)
_CMD = const(0x7E)

_SOFT_RESET = const(0xB6)
_FIFO_FLUSH = const(0xB0)
_DRDY_BOTH = const(0xC0)
_GYRO_AND_ACCEL = const(0xC0)
_ALL_ON = const(0x0E)
_ACCEL_NORMAL = const(0xA0)
_GYRO_NORMAL = const(0xE0)
_SAMPLE = const(12)
_FIFO_BYTES = const(2048)
_CONFIGURATION_BYTES = const(8192)
_CHUNK = const(64)
_READY = const(1)


class BMI270(Chip):
    """Driver of the BMI270. fifo: use the FIFO at 200 Hz and below, too; above, always. wake_mg: ignored.

    Raises ValueError for a setting outside the tables, OSError when the chip is absent or another one, and
    when its configuration is missing or the chip rejects it.
    """

    PART = 0
    # (public value, actual rate in mHz, code)
    RATES_HZ = (
        (25, 25000, 6),
        (50, 50000, 7),
        (100, 100000, 8),
        (200, 200000, 9),
        (400, 400000, 10),
        (800, 800000, 11),
        (1600, 1600000, 12),
    )
    # (public value, scale in 1e-9 deg/s per step, code)
    RANGES_DPS = (
        (125, 3814697, 4),
        (250, 7629395, 3),
        (500, 15258789, 2),
        (1000, 30517578, 1),
        (2000, 61035156, 0),
    )
    RANGES_G = ((2, 61035, 0), (4, 122070, 1), (8, 244141, 2), (16, 488281, 3))
    RESET = (_CMD, _SOFT_RESET, 2000)
    FIFO_SAMPLES = 170
    """Capacity of the FIFO in whole samples."""
    WHO_AM_I_REGISTER = _CHIP_ID
    WHO_AM_I = (0x24,)

    def __init__(self, i2c, address=0x68, *, odr_hz=200, range_dps=2000, range_g=16, fifo=False, wake_mg=0):
        odr, self.rate_mhz, odr_code = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = find_setting(self.RANGES_G, range_g)
        # 512 steps per °C.
        self.temperature_lsb_udegc = 1953
        self.temperature_offset_udegc = 23000000
        super().__init__(i2c, address)
        self.uses_fifo = fifo or odr > 200
        self.temperature_raw = self.realigned = 0
        self.was_running = self.read(_PWR_CTRL) != 0
        """True if it was already running: after power-on both sensors are off."""
        self._settings = (
            (_PWR_CONF, 0),
            (_ACC_CONF, _ACCEL_NORMAL | odr_code),
            (_ACC_RANGE, accel_code),
            (_GYR_CONF, _GYRO_NORMAL | odr_code),
            (_GYR_RANGE, gyro_code),
            (_FIFO_CONFIG_0, 0),
            (_FIFO_CONFIG_1, _GYRO_AND_ACCEL if self.uses_fifo else 0),
            (_PWR_CTRL, _ALL_ON),
        )
        self._standing = ((_CHIP_ID, self.who_am_i),) + self._settings
        self._burst = bytearray(_SAMPLE)
        self._pair = bytearray(2)
        self.configure()

    def _after_reset(self):
        """Upload the configuration and wait until the chip has accepted it."""
        if os.stat(CONFIGURATION)[6] != _CONFIGURATION_BYTES:
            raise OSError("{} has not {} bytes".format(CONFIGURATION, _CONFIGURATION_BYTES))
        self.write(_PWR_CONF, 0)
        time.sleep_us(450)
        self.write(_INIT_CTRL, 0)
        chunk, word = bytearray(_CHUNK), bytearray(2)
        with open(CONFIGURATION, "rb") as file:
            for at in range(0, _CONFIGURATION_BYTES, _CHUNK):
                file.readinto(chunk)
                # The address counts words of two bytes; its low four bits have a register of their own.
                word[0], word[1] = at >> 1 & 0x0F, at >> 5
                self.i2c.writeto_mem(self.address, _INIT_ADDR_0, word)
                self.i2c.writeto_mem(self.address, _INIT_DATA, chunk)
        self.write(_INIT_CTRL, 1)
        for _ in range(20):
            time.sleep_us(10000)
            if self.read(_INTERNAL_STATUS) & 0x0F == _READY:
                return
        raise OSError("{} is not accepted by the chip".format(CONFIGURATION))

    def ready(self):
        """Return True if a new sample of both triads is available."""
        return self.read(_STATUS) & _DRDY_BOTH == _DRDY_BOTH

    def read_into(self, words, at):
        """Read a sample of six words to words[at]; return 0 if there is no new one, else 1."""
        if not self.ready():
            return 0
        raw = self._burst
        self.i2c.readfrom_mem_into(self.address, _ACC_X_LSB, raw)
        for i in range(3):
            words[at + i] = _signed(raw[2 * i + 6] | raw[2 * i + 7] << 8)
            words[at + 3 + i] = _signed(raw[2 * i] | raw[2 * i + 1] << 8)
        return 1

    def fifo_level(self):
        """Return the number of whole samples in the FIFO; -1 if it is full and may have overflowed."""
        count = self._pair
        self.i2c.readfrom_mem_into(self.address, _FIFO_LENGTH_0, count)
        size = count[0] | (count[1] & 0x3F) << 8
        return size // _SAMPLE if size <= _FIFO_BYTES - _SAMPLE else -1

    def fifo_read_into(self, rows):
        """Read len(rows) / 12 whole samples in one burst; they are in the order of the wire."""
        self.i2c.readfrom_mem_into(self.address, _FIFO_DATA, rows)

    def fifo_flush(self):
        """Flush the FIFO and restart it at a whole sample."""
        self.write(_CMD, _FIFO_FLUSH)

    def read_temperature(self):
        """Update `temperature_raw`, which samples do not contain."""
        raw = self._pair
        self.i2c.readfrom_mem_into(self.address, _TEMPERATURE_0, raw)
        self.temperature_raw = _signed(raw[0] | raw[1] << 8)


def _signed(value):
    return value - 65536 if value & 0x8000 else value
