"""ICM-42688-P: gyro and accelerometer, whose FIFO stores the chip's time stamp with each sample (TDK).

chip = ICM42688(i2c, odr_hz=200, range_dps=2000, range_g=16)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng
"""

import time

from micropython import const

from drivers.chip import Chip, find_setting

_DEVICE_CONFIG = const(0x11)
_FIFO_CONFIG = const(0x16)
_TEMP_DATA1 = const(0x1D)
_INT_STATUS = const(0x2D)
_FIFO_COUNTL = const(0x2F)
_FIFO_DATA = const(0x30)
_INT_STATUS2 = const(0x37)
_SIGNAL_PATH_RESET = const(0x4B)
_INTF_CONFIG0 = const(0x4C)
_INTF_CONFIG1 = const(0x4D)
_PWR_MGMT0 = const(0x4E)
_GYRO_CONFIG0 = const(0x4F)
_ACCEL_CONFIG0 = const(0x50)
_TMST_CONFIG = const(0x54)
_SMD_CONFIG = const(0x57)
_FIFO_CONFIG1 = const(0x5F)
_WHO_AM_I = const(0x75)
_REG_BANK_SEL = const(0x76)
_ACCEL_WOM_X_THR = const(0x4A)  # bank 4, as those of y and z behind it

_SOFT_RESET = const(0x01)
_STREAM = const(0x40)
_DATA_RDY = const(0x08)
_FIFO_FULL = const(0x02)
_FIFO_FLUSH = const(0x02)
# The level of the FIFO in packets; the byte order stays big-endian.
_COUNT_PACKETS = const(0x70)
# The adaptive full scale, on at power-on, distorts fast rates and is switched off.
_FIXED_SCALE = const(0x51)
_BOTH_LOW_NOISE = const(0x0F)
_TIMESTAMP = const(0x21)
_PACKET_3 = const(0x0F)
_PACKET = const(16)
_HEADER_MASK = const(0xFC)
_HEADER = const(0x68)
_FULL = const(126)
_WOM_ANY_AXIS = const(0x07)
_WOM_ON = const(0x05)
_WOM_STEP_UG = const(3906)
_START_US = const(200)


class ICM42688(Chip):
    """Driver of the ICM-42688-P. fifo: use the FIFO at 200 Hz and below, too; above, always.

    wake_mg: step of the acceleration that sets MOTION_FLAG; 0: the detector is off.
    Raises ValueError for a setting outside the tables, OSError when the chip is absent or another one.
    """

    PART = 0
    # (public value, actual rate in mHz, code)
    RATES_HZ: tuple = (
        (13, 12500, 11),
        (25, 25000, 10),
        (50, 50000, 9),
        (100, 100000, 8),
        (200, 200000, 7),
        (500, 500000, 15),
        (1000, 1000000, 6),
    )
    # (public value, scale in 1e-9 deg/s per step, code)
    RANGES_DPS = (
        (125, 3814697, 0x80),
        (250, 7629395, 0x60),
        (500, 15258789, 0x40),
        (1000, 30517578, 0x20),
        (2000, 61035156, 0x00),
    )
    RANGES_G = ((2, 61035, 0x60), (4, 122070, 0x40), (8, 244141, 0x20), (16, 488281, 0x00))
    RESET = (_DEVICE_CONFIG, _SOFT_RESET, 1000)
    FIFO_SAMPLES = 128
    """Capacity of the FIFO in whole samples."""
    WHO_AM_I_REGISTER = _WHO_AM_I
    WHO_AM_I = (0x47,)
    MOTION_FLAG = (_INT_STATUS2, _WOM_ANY_AXIS)

    def __init__(self, i2c, address=0x68, *, odr_hz=200, range_dps=2000, range_g=16, fifo=False, wake_mg=0):
        odr, self.rate_mhz, odr_code = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = find_setting(self.RANGES_G, range_g)
        # 132.48 steps per °C.
        self.temperature_lsb_udegc = 7548
        self.temperature_offset_udegc = 25000000
        super().__init__(i2c, address)
        self.uses_fifo = fifo or odr > 200
        self.temperature_raw = self.realigned = 0
        self.was_running = self.read(_PWR_MGMT0) != 0
        """True if it was already running: after power-on both sensors are off."""
        self._overdue = 1500000000 // self.rate_mhz
        """us between two samples that show that one is missing: one period and a half."""
        settings = (
            (_INTF_CONFIG0, _COUNT_PACKETS),
            (_INTF_CONFIG1, _FIXED_SCALE),
            (_TMST_CONFIG, _TIMESTAMP),
            (_FIFO_CONFIG1, _PACKET_3 if self.uses_fifo else 0),
            (_FIFO_CONFIG, _STREAM if self.uses_fifo else 0),
            (_GYRO_CONFIG0, gyro_code | odr_code),
            (_ACCEL_CONFIG0, accel_code | odr_code),
            (_SMD_CONFIG, _WOM_ON if wake_mg else 0),
            (_PWR_MGMT0, _BOTH_LOW_NOISE),
        )
        self._standing = ((_WHO_AM_I, self.who_am_i),) + settings
        self._settings = settings
        if wake_mg:
            step = min(max(wake_mg * 1000 // _WOM_STEP_UG, 1), 255)
            thresholds: tuple = ((_REG_BANK_SEL, 4),)
            for axis in range(3):
                thresholds += ((_ACCEL_WOM_X_THR + axis, step),)
            self._settings = thresholds + ((_REG_BANK_SEL, 0),) + settings
        self._burst = bytearray(14)
        self._pair = memoryview(self._burst)[:2]
        self._ready = 0
        self._ticks = -1
        self.shape(1)
        self.configure()

    def shape(self, batch):
        """Set the number of samples that `fifo_read_into` reads."""
        self._raw = bytearray(batch * _PACKET)

    def ready(self):
        """Return True if a new sample is available."""
        # Reading the flag clears it.
        self._ready |= self.read(_INT_STATUS)
        return self._ready & _DATA_RDY

    def read_into(self, words, at):
        """Read a sample of six words to words[at]; return 0 if there is no new one, else 1."""
        if not self.ready():
            return 0
        self._ready = 0
        raw = self._burst
        self.i2c.readfrom_mem_into(self.address, _TEMP_DATA1, raw)
        self.temperature_raw = _signed(raw[0] << 8 | raw[1])
        for i in range(3):
            words[at + i] = _signed(raw[2 * i + 8] << 8 | raw[2 * i + 9])
            words[at + 3 + i] = _signed(raw[2 * i + 2] << 8 | raw[2 * i + 3])
        return 1

    def fifo_level(self):
        """Return the number of whole samples in the FIFO; -1 if it has overflowed."""
        # Fewer than 256 packets fit, so the low byte, which latches both, is the level.
        level = self.read(_FIFO_COUNTL)
        if level >= _FULL and self.read(_INT_STATUS) & _FIFO_FULL:
            return -1
        return level

    def fifo_read_into(self, rows):
        """Read len(rows) / 12 samples in one burst, reordered to the order of the wire.

        Return True if packets are missing between them, by the chip's time stamps.
        """
        raw, at, torn = self._raw, 0, False
        self.i2c.readfrom_mem_into(self.address, _FIFO_DATA, raw)
        for to in range(0, len(rows), 12):
            ticks = raw[at + 14] << 8 | raw[at + 15]
            late = self._ticks >= 0 and (ticks - self._ticks) & 0xFFFF > self._overdue
            if late or raw[at] & _HEADER_MASK != _HEADER:
                torn = True
            self._ticks = ticks
            for i in range(0, 6, 2):
                rows[to + i] = raw[at + 8 + i]
                rows[to + 1 + i] = raw[at + 7 + i]
                rows[to + 6 + i] = raw[at + 2 + i]
                rows[to + 7 + i] = raw[at + 1 + i]
            at += _PACKET
        return torn

    def fifo_flush(self):
        """Flush the FIFO and restart it at a whole sample."""
        # After the sensors are switched on no register may be written for this time.
        time.sleep_us(_START_US)
        self._ticks = -1
        self.write(_SIGNAL_PATH_RESET, _FIFO_FLUSH)
        self.read(_INT_STATUS)

    def read_temperature(self):
        """Update `temperature_raw`."""
        raw = self._pair
        self.i2c.readfrom_mem_into(self.address, _TEMP_DATA1, raw)
        self.temperature_raw = _signed(raw[0] << 8 | raw[1])


def _signed(value):
    return value - 65536 if value & 0x8000 else value


class ICM42688Spi(ICM42688):
    """Driver of an ICM-42688-P on SPI; on I2C, 2000 Hz leave no time for the rest of the loop."""

    RATES_HZ = ICM42688.RATES_HZ + ((2000, 2000000, 5),)
