"""LSM6DSO, LSM6DSOX and LSM6DSR: gyro and accelerometer with a tagged FIFO (ST).

chip = LSM6DSO(i2c, odr_hz=208, range_dps=2000, range_g=16)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng

Each word of the FIFO has a tag: its sensor, and a counter of two bits that advances with each sample. Up to
416 Hz the chip's time stamp is stored with each sample; above, the bus has no time for it.
"""

from micropython import const

from drivers.chip import setting
from drivers.st_imu import StImu

_FIFO_CTRL3 = const(0x09)
_FIFO_CTRL4 = const(0x0A)
_WHO_AM_I = const(0x0F)
_CTRL1_XL = const(0x10)
_CTRL2_G = const(0x11)
_CTRL3_C = const(0x12)
_CTRL10_C = const(0x19)
_WAKE_UP_SRC = const(0x1B)
_FIFO_STATUS1 = const(0x3A)
_TAP_CFG0 = const(0x56)
_TAP_CFG2 = const(0x58)
_WAKE_UP_THS = const(0x5B)
_WAKE_UP_DUR = const(0x5C)
_MD1_CFG = const(0x5E)
_INTERNAL_FREQ_FINE = const(0x63)
_FIFO_DATA_OUT_TAG = const(0x78)

_SW_RESET = const(0x01)
_BDU_IF_INC = const(0x44)
_TIMESTAMP_EN = const(0x20)
_BYPASS = const(0)
_CONTINUOUS = const(0x06)
_TIMESTAMP_EVERY = const(0x40)
_OVERRUN = const(0x40)
_NEAR_CARRY = const(250)
_WORD = const(7)
_TAG_GYRO = const(1)
_TAG_ACCEL = const(2)
_TAG_TIMESTAMP = const(4)
_WU_IA = const(0x08)
# Wake-up interrupt: enabled, latched, without a minimum duration, on INT1.
_WAKE_SETTINGS = (
    (_TAP_CFG0, 0x01),
    (_TAP_CFG2, 0x80),
    (_WAKE_UP_DUR, 0),
    (_MD1_CFG, 0x20),
)
_THRESHOLD_STEPS = const(64)  # steps of WAKE_UP_THS over the full scale of the accelerometer
_TICKS_PER_KS = const(40000000)
"""Time stamps advance 40,000 times a second."""


class LSM6DSO(StImu):
    """Driver of the LSM6DSO. fifo: use the FIFO at 208 Hz and below, too; above, always.

    wake_mg: step of the acceleration that sets MOTION_FLAG; 0: the detector is off.
    settings: written in place of a reset, for a chip that has been configured before.
    Raises ValueError for a setting outside the tables, OSError when the chip is absent or another one.
    """

    PART = 0
    # (public value, nominal rate in mHz, code): 6667 Hz / 512, / 256, .. / 8. At / 4 two tagged words
    # a sample fill an I2C bus of 400 kHz and the processor of a Pico.
    RATES_HZ = (
        (13, 13021, 1),
        (26, 26043, 2),
        (52, 52086, 3),
        (104, 104172, 4),
        (208, 208344, 5),
        (416, 416688, 6),
        (833, 833375, 7),
    )
    # (public value, scale in 1e-9 deg/s per step, code)
    RANGES_DPS: tuple = (
        (125, 4375000, 0x02),
        (250, 8750000, 0x00),
        (500, 17500000, 0x04),
        (1000, 35000000, 0x08),
        (2000, 70000000, 0x0C),
    )
    RANGES_G = ((2, 61000, 0x00), (4, 122000, 0x08), (8, 244000, 0x0C), (16, 488000, 0x04))
    IS_TAGGED = True
    RESET = (_CTRL3_C, _SW_RESET, 100)
    WHO_AM_I = (0x6C,)
    MOTION_FLAG = (_WAKE_UP_SRC, _WU_IA)

    def __init__(
        self, i2c, address=0x6B, *, odr_hz=208, range_dps=2000, range_g=16, fifo=False, wake_mg=0, settings=()
    ):
        odr, rate_mhz, odr_code = setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = setting(self.RANGES_G, range_g)
        self.temperature_lsb_udegc = 3906
        self.temperature_offset_udegc = 25000000
        super().__init__(i2c, address)
        self.uses_fifo = fifo or odr > 208
        self.was_running = self.read(_CTRL2_G) != 0
        """True if the gyro was already running: after power-on it is off, so the chip has kept its power."""
        self._words = 3 if odr <= 416 else 2
        self.FIFO_SAMPLES = 512 // self._words
        """Capacity of the FIFO in whole samples."""
        fine = self.read(_INTERNAL_FREQ_FINE)
        # The factory measures the rate of each chip, in steps of 0.15 %.
        self.rate_mhz = rate_mhz * (2000 + 3 * (fine - 256 if fine & 0x80 else fine)) // 2000
        self._overdue = 3 * _TICKS_PER_KS // (2 * rate_mhz)
        """Ticks of the chip between two samples that show that one is missing: one period and a half."""
        self._fifo_on = _CONTINUOUS | (_TIMESTAMP_EVERY if self._words > 2 else 0)
        self._settings = (
            (_CTRL3_C, _BDU_IF_INC),
            (_CTRL10_C, _TIMESTAMP_EN if self.uses_fifo else 0),
            (_FIFO_CTRL3, odr_code << 4 | odr_code if self.uses_fifo else 0),
            (_CTRL1_XL, odr_code << 4 | accel_code),
            (_CTRL2_G, odr_code << 4 | gyro_code),
        )
        self._settings += settings
        if wake_mg:
            steps = wake_mg * _THRESHOLD_STEPS // (1000 * self.range_g)
            self._settings += _WAKE_SETTINGS + ((_WAKE_UP_THS, steps if steps else 1),)
        fifo_mode = self._fifo_on if self.uses_fifo else 0
        self._standing = ((_WHO_AM_I, self.who_am_i), (_FIFO_CTRL4, fifo_mode)) + self._settings
        self._level = memoryview(self._status)[:2]
        self._count = self._ticks = -1
        self.shape(1)
        self.configure(reset=not settings)

    def shape(self, batch):
        """Set the number of samples that `fifo_read_into` reads."""
        self._raw = bytearray(batch * self._words * _WORD)

    def fifo_level(self):
        """Return the number of whole samples in the FIFO; -1 if it has overflowed."""
        status, last = self._level, -1
        self.i2c.readfrom_mem_into(self.address, _FIFO_STATUS1, status)
        # A word between the two bytes makes the level 256 too large: read until two readings agree.
        while status[0] >= _NEAR_CARRY and (status[1] << 8 | status[0]) != last:
            last = status[1] << 8 | status[0]
            self.i2c.readfrom_mem_into(self.address, _FIFO_STATUS1, status)
        if status[1] & _OVERRUN:
            return -1
        return (status[0] | (status[1] & 0x03) << 8) // self._words

    def fifo_read_into(self, rows):
        """Read len(rows) / 12 samples in one burst, in the order of the wire.

        Return True if words are missing between them, by their counters and the chip's time stamps.
        """
        raw, size = self._raw, _WORD * self._words
        self.i2c.readfrom_mem_into(self.address, _FIFO_DATA_OUT_TAG, raw)
        at, torn = 0, False
        for to in range(0, len(rows), 12):
            count = raw[at] & 0x06
            if self._count >= 0 and count != (self._count + 2) & 0x06:
                torn = True
            self._count = count
            end = at + size
            while at < end:
                kind = raw[at] >> 3
                if raw[at] & 0x06 != count:
                    torn = True
                if kind == _TAG_GYRO or kind == _TAG_ACCEL:
                    first = to if kind == _TAG_GYRO else to + 6
                    for i in range(6):
                        rows[first + i] = raw[at + 1 + i]
                elif kind == _TAG_TIMESTAMP:
                    ticks = raw[at + 1] | raw[at + 2] << 8
                    if self._ticks >= 0 and (ticks - self._ticks) & 0xFFFF > self._overdue:
                        torn = True
                    self._ticks = ticks
                else:
                    torn = True
                at += _WORD
        return torn

    def forget_counters(self):
        """Accept any counter and time stamp with the next sample."""
        self._count = self._ticks = -1

    def fifo_flush(self):
        """Flush the FIFO and restart it at a whole sample."""
        self.forget_counters()
        self.write(_FIFO_CTRL4, _BYPASS)
        self.write(_FIFO_CTRL4, self._fifo_on)


class LSM6DSR(LSM6DSO):
    """LSM6DSR, LSM6DSRX and ASM330LHH: the same registers, and a range of 4000 deg/s."""

    RANGES_DPS = LSM6DSO.RANGES_DPS + ((4000, 140000000, 0x01),)
    WHO_AM_I = (0x6B,)
