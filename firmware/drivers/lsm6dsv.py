"""LSM6DSV, LSM6DSV16X and LSM6DSV320X: gyro of up to 4000 deg/s and accelerometer with a tagged FIFO (ST).

chip = LSM6DSV(i2c, odr_hz=240, range_dps=4000, range_g=16)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng

Registers: ST DS13510 (LSM6DSV16X), DS14623 (LSM6DSV320X), AN5763, and the names of ST's lsm6dsv16x_reg.h.
Other than in an LSM6DSO the ranges have registers of their own, and the FIFO holds half as many words. An
LSM6DSV32X has the identity of an LSM6DSV and twice its range: this driver would halve its accelerations. The
high-g triad of an LSM6DSV320X or LSM6DSV80X stays off; the range of 125 deg/s, which these lack, is not used.
"""

from micropython import const

from drivers.chip import find_setting
from drivers.st_tagged import TaggedImu

_FIFO_CTRL3 = const(0x09)
_CTRL1 = const(0x10)
_CTRL2 = const(0x11)
_CTRL3 = const(0x12)
_CTRL6 = const(0x15)
_CTRL8 = const(0x17)
_FIFO_STATUS1 = const(0x1B)
_WAKE_UP_SRC = const(0x45)
_INTERNAL_FREQ = const(0x4F)
_FUNCTIONS_ENABLE = const(0x50)
_INACTIVITY_DUR = const(0x54)
_TAP_CFG0 = const(0x56)
_WAKE_UP_THS = const(0x5B)
_WAKE_UP_DUR = const(0x5C)
_MD1_CFG = const(0x5E)

_LSM6DSV = const(0x70)
_LSM6DSV320X = const(0x73)
_FS_4000 = const(0x0C)
_FS_4000_OF_320X = const(0x05)
_BDU_IF_INC = const(0x44)
_TIMESTAMP_EN = const(0x40)
_INTERRUPTS_ENABLE = const(0x80)
_WU_IA = const(0x08)
# Wake-up interrupt: latched, threshold in steps of 7.8125 mg at each range, no minimum duration, on INT1.
_WAKE_SETTINGS = (
    (_TAP_CFG0, 0x01),
    (_INACTIVITY_DUR, 0x04),
    (_WAKE_UP_DUR, 0),
    (_MD1_CFG, 0x20),
)
_THRESHOLD_STEPS = const(128)  # steps of WAKE_UP_THS per g
_MOST_STEPS = const(63)


class LSM6DSV(TaggedImu):
    """Driver of the LSM6DSV family. fifo: use the FIFO at 240 Hz and below, too; above, always.

    wake_mg: step of the acceleration that sets MOTION_FLAG; 0: the detector is off.
    settings: written in place of a reset, for a chip that has been configured before.
    Raises ValueError for a setting outside the tables, OSError when the chip is absent or another one.
    """

    # (public value, nominal rate in mHz, code): 7680 Hz / 512, / 256, .. / 8; above, as for an LSM6DSO.
    RATES_HZ = (
        (15, 15000, 3),
        (30, 30000, 4),
        (60, 60000, 5),
        (120, 120000, 6),
        (240, 240000, 7),
        (480, 480000, 8),
        (960, 960000, 9),
    )
    # (public value, scale in 1e-9 deg/s per step, code)
    RANGES_DPS = (
        (250, 8750000, 1),
        (500, 17500000, 2),
        (1000, 35000000, 3),
        (2000, 70000000, 4),
        (4000, 140000000, _FS_4000),
    )
    RANGES_G = ((2, 61000, 0), (4, 122000, 1), (8, 244000, 2), (16, 488000, 3))
    FIFO_STATUS = _FIFO_STATUS1
    FIFO_WORDS = 256
    TICKS_PER_KS = 46080000
    RATE_TRIM = (_INTERNAL_FREQ, 13)
    WHO_AM_I = (_LSM6DSV, _LSM6DSV320X)
    MOTION_FLAG = (_WAKE_UP_SRC, _WU_IA)

    def __init__(
        self, i2c, address=0x6B, *, odr_hz=240, range_dps=2000, range_g=16, fifo=False, wake_mg=0, settings=()
    ):
        odr, rate_mhz, odr_code = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = find_setting(self.RANGES_G, range_g)
        super().__init__(i2c, address, rate_mhz, odr <= 480)
        if gyro_code == _FS_4000 and self.who_am_i == _LSM6DSV320X:
            gyro_code = _FS_4000_OF_320X
        self.uses_fifo = fifo or odr > 240
        functions = (_TIMESTAMP_EN if self.uses_fifo else 0) | (_INTERRUPTS_ENABLE if wake_mg else 0)
        # Codes of the rates select the high-performance mode.
        wanted = (
            (_CTRL3, _BDU_IF_INC),
            (_FUNCTIONS_ENABLE, functions),
            (_FIFO_CTRL3, odr_code << 4 | odr_code if self.uses_fifo else 0),
            (_CTRL6, gyro_code),
            (_CTRL8, accel_code),
            (_CTRL1, odr_code),
            (_CTRL2, odr_code),
        )
        wanted += settings
        if wake_mg:
            steps = min(max((wake_mg * _THRESHOLD_STEPS + 500) // 1000, 1), _MOST_STEPS)
            wanted += _WAKE_SETTINGS + ((_WAKE_UP_THS, steps),)
        self.start(wanted, reset=not settings)
