"""LSM6DSO, LSM6DSOX and LSM6DSR: gyro and accelerometer with a tagged FIFO (ST).

chip = LSM6DSO(i2c, odr_hz=208, range_dps=2000, range_g=16)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng
"""

from micropython import const

from drivers.chip import find_setting
from drivers.st_tagged import TaggedImu

_FIFO_CTRL3 = const(0x09)
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

_BDU_IF_INC = const(0x44)
_TIMESTAMP_EN = const(0x20)
_WU_IA = const(0x08)
# Wake-up interrupt: enabled, latched, without a minimum duration, on INT1.
_WAKE_SETTINGS = (
    (_TAP_CFG0, 0x01),
    (_TAP_CFG2, 0x80),
    (_WAKE_UP_DUR, 0),
    (_MD1_CFG, 0x20),
)
_THRESHOLD_STEPS = const(64)  # steps of WAKE_UP_THS over the full scale of the accelerometer


class LSM6DSO(TaggedImu):
    """Driver of the LSM6DSO. fifo: use the FIFO at 208 Hz and below, too; above, always.

    wake_mg: step of the acceleration that sets MOTION_FLAG; 0: the detector is off.
    settings: written in place of a reset, for a chip that has been configured before.
    Raises ValueError for a setting outside the tables, OSError when the chip is absent or another one.
    """

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
    FIFO_STATUS = _FIFO_STATUS1
    FIFO_WORDS = 512
    TICKS_PER_KS = 40000000
    RATE_TRIM = (_INTERNAL_FREQ_FINE, 15)
    WHO_AM_I = (0x6C,)
    MOTION_FLAG = (_WAKE_UP_SRC, _WU_IA)

    def __init__(
        self, i2c, address=0x6B, *, odr_hz=208, range_dps=2000, range_g=16, fifo=False, wake_mg=0, settings=()
    ):
        odr, rate_mhz, odr_code = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = find_setting(self.RANGES_G, range_g)
        super().__init__(i2c, address, rate_mhz, odr <= 416)
        self.uses_fifo = fifo or odr > 208
        wanted = (
            (_CTRL3_C, _BDU_IF_INC),
            (_CTRL10_C, _TIMESTAMP_EN if self.uses_fifo else 0),
            (_FIFO_CTRL3, odr_code << 4 | odr_code if self.uses_fifo else 0),
            (_CTRL1_XL, odr_code << 4 | accel_code),
            (_CTRL2_G, odr_code << 4 | gyro_code),
        )
        wanted += settings
        if wake_mg:
            steps = wake_mg * _THRESHOLD_STEPS // (1000 * self.range_g)
            wanted += _WAKE_SETTINGS + ((_WAKE_UP_THS, steps if steps else 1),)
        self.start(wanted, reset=not settings)


class LSM6DSR(LSM6DSO):
    """LSM6DSR, LSM6DSRX and ASM330LHH: the same registers, and a range of 4000 deg/s."""

    RANGES_DPS = LSM6DSO.RANGES_DPS + ((4000, 140000000, 0x01),)
    WHO_AM_I = (0x6B,)
