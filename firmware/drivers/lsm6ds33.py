"""LSM6DS33: gyro and accelerometer of the MinIMU-9 (ST, register family of the LSM6DS3).

chip = LSM6DS33(i2c, odr_hz=208, range_dps=2000, range_g=16)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng
"""

from micropython import const
from wire import PART_LSM6DS33

from drivers.chip import find_setting
from drivers.st_imu import StImu

_FIFO_CTRL3 = const(0x08)
_FIFO_CTRL5 = const(0x0A)
_WHO_AM_I = const(0x0F)
_CTRL1_XL = const(0x10)
_CTRL2_G = const(0x11)
_CTRL3_C = const(0x12)
_WAKE_UP_SRC = const(0x1B)
_FIFO_STATUS1 = const(0x3A)
_FIFO_DATA_OUT = const(0x3E)
_TAP_CFG = const(0x58)
_WAKE_UP_THS = const(0x5B)
_WAKE_UP_DUR = const(0x5C)
_MD1_CFG = const(0x5E)

_SW_RESET = const(0x01)
_BDU_IF_INC = const(0x44)
_NO_DECIMATION = const(0x09)
_BYPASS = const(0)
_CONTINUOUS = const(6)
_OVERRUN = const(0x40)
_PATTERN = const(6)
_NEAR_CARRY = const(250)
_WU_IA = const(0x08)
# Wake-up interrupt: latched, without a minimum duration, on INT1.
_WAKE_SETTINGS = ((_TAP_CFG, 0x01), (_WAKE_UP_DUR, 0), (_MD1_CFG, 0x20))
_THRESHOLD_STEPS = const(64)  # steps of WAKE_UP_THS over the full scale of the accelerometer


class LSM6DS33(StImu):
    """Driver of the LSM6DS33. fifo: use the FIFO at 208 Hz and below, too; above, always.

    wake_mg: step of the acceleration that sets MOTION_FLAG; 0: the detector is off.
    settings: written in place of a reset, for a chip that has been configured before.
    Raises ValueError for a setting outside the tables, OSError when the chip is absent or another one.
    """

    PART = PART_LSM6DS33
    # (public value, actual rate in mHz, code)
    RATES_HZ = (
        (13, 12500, 1),
        (26, 26000, 2),
        (52, 52000, 3),
        (104, 104000, 4),
        (208, 208000, 5),
        (416, 416000, 6),
        (833, 833000, 7),
        (1660, 1660000, 8),
    )
    # (public value, scale in 1e-9 deg/s per step, code). The scale is not range / 32768 but up to 17 % more.
    RANGES_DPS = (
        (125, 4375000, 0x02),
        (245, 8750000, 0x00),
        (500, 17500000, 0x04),
        (1000, 35000000, 0x08),
        (2000, 70000000, 0x0C),
    )
    RANGES_G = ((2, 61000, 0x00), (4, 122000, 0x08), (8, 244000, 0x0C), (16, 488000, 0x04))
    RESET = (_CTRL3_C, _SW_RESET, 100)
    FIFO_SAMPLES = 682
    """Capacity of the FIFO in whole samples."""
    WHO_AM_I = (0x69,)
    MOTION_FLAG = (_WAKE_UP_SRC, _WU_IA)

    def __init__(
        self, i2c, address=0x6B, *, odr_hz=208, range_dps=2000, range_g=16, fifo=False, wake_mg=0, settings=()
    ):
        odr, self.rate_mhz, odr_code = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = find_setting(self.RANGES_G, range_g)
        self.temperature_lsb_udegc = 62500
        self.temperature_offset_udegc = 25000000
        super().__init__(i2c, address)
        self.uses_fifo = fifo or odr > 208
        self.was_running = self.read(_CTRL2_G) != 0
        """True if the gyro was already running: after power-on it is off, so the chip has kept its power."""
        self._settings = (
            (_FIFO_CTRL3, _NO_DECIMATION if self.uses_fifo else 0),
            (_CTRL3_C, _BDU_IF_INC),
            (_CTRL1_XL, odr_code << 4 | accel_code),
            (_CTRL2_G, odr_code << 4 | gyro_code),
        )
        self._settings += settings
        if wake_mg:
            steps = wake_mg * _THRESHOLD_STEPS // (1000 * self.range_g)
            self._settings += _WAKE_SETTINGS + ((_WAKE_UP_THS, steps if steps else 1),)
        self._fifo_on = odr_code << 3 | _CONTINUOUS
        fifo_mode = self._fifo_on if self.uses_fifo else 0
        self._standing = ((_WHO_AM_I, self.who_am_i), (_FIFO_CTRL5, fifo_mode)) + self._settings
        self._level = memoryview(self._status)[:2]
        self.configure(reset=not settings)

    def fifo_level(self):
        """Return the number of whole samples in the FIFO; -1 if it has overflowed."""
        status = self._level
        self.i2c.readfrom_mem_into(self.address, _FIFO_STATUS1, status)
        if status[0] >= _NEAR_CARRY:
            self._reread()
        if status[1] & _OVERRUN:
            return -1
        words = status[0] | (status[1] & 0x0F) << 8
        if words % _PATTERN:
            return self.realign(words)
        return words // _PATTERN

    def _reread(self):
        """Read the level until two readings agree: a sample between its two bytes makes it 256 too large."""
        status = self._level
        last = -1
        while status[0] >= _NEAR_CARRY and (status[1] << 8 | status[0]) != last:
            last = status[1] << 8 | status[0]
            self.i2c.readfrom_mem_into(self.address, _FIFO_STATUS1, status)

    def realign(self, words):
        """Discard words of a torn sample, so that the next is a gyro x; return the whole samples."""
        status = self._status
        self.i2c.readfrom_mem_into(self.address, _FIFO_STATUS1, status)
        pattern = (status[2] | (status[3] & 0x03) << 8) % _PATTERN
        # The level has twelve bits: that of a full FIFO reads zero.
        words = status[0] | (status[1] & 0x0F) << 8 or words
        torn = _PATTERN - pattern
        if not pattern:
            return words // _PATTERN
        if words < torn:
            return 0
        for _ in range(torn):
            self.i2c.readfrom_mem_into(self.address, _FIFO_DATA_OUT, self._level)
        self.realigned += 1
        return (words - torn) // _PATTERN

    def fifo_read_into(self, rows):
        """Read len(rows) / 12 whole samples in one burst, in the order of the wire."""
        self.i2c.readfrom_mem_into(self.address, _FIFO_DATA_OUT, rows)

    def fifo_flush(self):
        """Flush the FIFO and restart it at a whole sample."""
        self.write(_FIFO_CTRL5, _BYPASS)
        self.write(_FIFO_CTRL5, self._fifo_on)
