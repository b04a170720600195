"""ICM-20948: gyro and accelerometer in four banks of registers (TDK InvenSense).

chip = ICM20948(i2c, odr_hz=225, range_dps=2000, range_g=16)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng

Its magnetometer is a chip of its own on an inner bus, which is connected to the outer one. All that sampling
needs is in bank 0; the others are selected while the chip is configured, and each second to compare its
settings. A processor that is reset within that millisecond does not recognise the chip until its power is
cycled.
"""

from micropython import const

from drivers.chip import Chip, find_setting

# Bank 0.
_WHO_AM_I = const(0x00)
_USER_CTRL = const(0x03)
_PWR_MGMT_1 = const(0x06)
_PWR_MGMT_2 = const(0x07)
_INT_PIN_CFG = const(0x0F)
_INT_ENABLE_1 = const(0x11)
_INT_STATUS_1 = const(0x1A)
_INT_STATUS_2 = const(0x1B)
_ACCEL_XOUT_H = const(0x2D)
_TEMP_OUT_H = const(0x39)
_FIFO_EN_2 = const(0x67)
_FIFO_RST = const(0x68)
_FIFO_COUNTH = const(0x70)
_FIFO_R_W = const(0x72)
_REG_BANK_SEL = const(0x7F)
# Bank 2.
_GYRO_SMPLRT_DIV = const(0x00)
_GYRO_CONFIG_1 = const(0x01)
_ODR_ALIGN_EN = const(0x09)
_ACCEL_SMPLRT_DIV_2 = const(0x11)
_ACCEL_CONFIG = const(0x14)

_DEVICE_RESET = const(0x80)
_BEST_CLOCK = const(0x01)
_BANK_2 = const(0x20)
_BYPASS = const(0x02)
_LOW_PASS_ON = const(0x01)
_DATA_READY = const(0x01)
_FIFO_OVERFLOW = const(0x1F)
_FIFO_ON = const(0x40)
_ALL_FIFOS = const(0x1F)
_ACCEL_AND_GYRO = const(0x1E)
_SAMPLE = const(12)
_FIFO_BYTES = const(512)


class ICM20948(Chip):
    """Driver of the ICM-20948. fifo: use the FIFO at 225 Hz and below, too; above, always. wake_mg: ignored.

    Raises ValueError for a setting outside the tables, OSError when the chip is absent or another one.
    """

    PART = 0
    # (public value, actual rate in mHz, divider of 1125 Hz minus 1, codes of low-passes below half the rate:
    # gyro, accelerometer)
    RATES_HZ = (
        (13, 12500, 89, 6, 6),
        (25, 25000, 44, 5, 5),
        (56, 56250, 19, 4, 4),
        (75, 75000, 14, 4, 4),
        (125, 125000, 8, 3, 3),
        (225, 225000, 4, 3, 3),
        (375, 375000, 2, 1, 2),
        (563, 562500, 1, 0, 1),
        (1125, 1125000, 0, 7, 1),
    )
    # (public value, scale in 1e-9 deg/s per step, code)
    RANGES_DPS = ((250, 7629395, 0), (500, 15258789, 2), (1000, 30517578, 4), (2000, 61035156, 6))
    RANGES_G = ((2, 61035, 0), (4, 122070, 2), (8, 244141, 4), (16, 488281, 6))
    RESET = (_PWR_MGMT_1, _DEVICE_RESET, 10000)
    FIFO_SAMPLES = 42
    """Capacity of the FIFO in whole samples."""
    WHO_AM_I_REGISTER = _WHO_AM_I
    WHO_AM_I = (0xEA,)

    def __init__(self, i2c, address=0x68, *, odr_hz=225, range_dps=2000, range_g=16, fifo=False, wake_mg=0):
        odr, self.rate_mhz, divider, gyro_pass, accel_pass = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = find_setting(self.RANGES_G, range_g)
        # 333.87 steps per °C.
        self.temperature_lsb_udegc = 2995
        self.temperature_offset_udegc = 21000000
        super().__init__(i2c, address)
        self.uses_fifo = fifo or odr > 225
        self.temperature_raw = self.realigned = 0
        self._bank_2 = (
            (_GYRO_SMPLRT_DIV, divider),
            (_GYRO_CONFIG_1, gyro_pass << 3 | gyro_code | _LOW_PASS_ON),
            (_ODR_ALIGN_EN, 1),
            (_ACCEL_SMPLRT_DIV_2, divider),
            (_ACCEL_CONFIG, accel_pass << 3 | accel_code | _LOW_PASS_ON),
        )
        bank_0 = (
            (_PWR_MGMT_1, _BEST_CLOCK),
            (_PWR_MGMT_2, 0),
            (_INT_PIN_CFG, _BYPASS),
            (_INT_ENABLE_1, _DATA_READY),
            (_FIFO_EN_2, _ACCEL_AND_GYRO if self.uses_fifo else 0),
        )
        self._settings = bank_0 + ((_REG_BANK_SEL, _BANK_2),) + self._bank_2 + ((_REG_BANK_SEL, 0),)
        user_control = _FIFO_ON if self.uses_fifo else 0
        self._standing = ((_WHO_AM_I, self.who_am_i), (_USER_CTRL, user_control)) + bank_0
        self.was_running = self.read(_INT_ENABLE_1) != 0
        """True if it was already configured: power-on clears this register."""
        self._burst = bytearray(14)
        self._count = bytearray(2)
        self._ready = 0
        self.configure()

    def intact(self):
        """Return True while WHO_AM_I and settings persist in the chip: a supply dip resets them."""
        # A failed transfer may have left another bank.
        self.write(_REG_BANK_SEL, 0)
        if not self._holds(self._standing):
            return False
        self.write(_REG_BANK_SEL, _BANK_2)
        same = self._holds(self._bank_2)
        self.write(_REG_BANK_SEL, 0)
        return same

    def ready(self):
        """Return True if a new sample is available."""
        # Reading the flag clears it.
        self._ready |= self.read(_INT_STATUS_1)
        return self._ready & _DATA_READY

    def read_into(self, words, at):
        """Read a sample of six words to words[at]; return 0 if there is no new one, else 1."""
        if not self.ready():
            return 0
        self._ready = 0
        raw = self._burst
        self.i2c.readfrom_mem_into(self.address, _ACCEL_XOUT_H, raw)
        for i in range(3):
            words[at + i] = _signed(raw[2 * i + 6] << 8 | raw[2 * i + 7])
            words[at + 3 + i] = _signed(raw[2 * i] << 8 | raw[2 * i + 1])
        self.temperature_raw = _signed(raw[12] << 8 | raw[13])
        return 1

    def fifo_level(self):
        """Return the number of whole samples in the FIFO; -1 if it has overflowed."""
        count = self._count
        self.i2c.readfrom_mem_into(self.address, _FIFO_COUNTH, count)
        size = (count[0] & 0x1F) << 8 | count[1]
        # The flag is read only when the FIFO is full: another transfer would blur the time of this poll.
        if size > _FIFO_BYTES - _SAMPLE and self.read(_INT_STATUS_2) & _FIFO_OVERFLOW:
            return -1
        return size // _SAMPLE

    def fifo_read_into(self, rows):
        """Read len(rows) / 12 whole samples in one burst, reordered to the order of the wire."""
        self.i2c.readfrom_mem_into(self.address, _FIFO_R_W, rows)
        # Big-endian accelerometer, then gyro: each byte is swapped with one of the other triad.
        for at in range(0, len(rows), 12):
            for i in range(0, 6, 2):
                rows[at + i], rows[at + i + 7] = rows[at + i + 7], rows[at + i]
                rows[at + i + 1], rows[at + i + 6] = rows[at + i + 6], rows[at + i + 1]

    def fifo_flush(self):
        """Flush the FIFO and restart it at a whole sample."""
        self.write(_USER_CTRL, 0)
        self.write(_FIFO_RST, _ALL_FIFOS)
        self.write(_FIFO_RST, 0)
        self.write(_USER_CTRL, _FIFO_ON)
        # Reading the flag of an overflow clears it.
        self.read(_INT_STATUS_2)

    def read_temperature(self):
        """Update `temperature_raw`, which samples in the FIFO do not contain."""
        raw = self._count
        self.i2c.readfrom_mem_into(self.address, _TEMP_OUT_H, raw)
        self.temperature_raw = _signed(raw[0] << 8 | raw[1])


def _signed(value):
    return value - 65536 if value & 0x8000 else value
