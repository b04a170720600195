"""Emulated LSM6DSV and LSM6DSV320X: an LSM6DSO with other registers and rates, and half of its FIFO."""

from __future__ import annotations

from hubodo.emulator.chips.imu import accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.lsm6ds33 import (
    CTRL1_XL,
    CTRL2_G,
    CTRL3_C,
    MD1_CFG,
    OUT_TEMP_L,
    STATUS,
    TIMESTAMP0,
    WAKE_UP_DUR,
    WAKE_UP_THS,
    WHO_AM_I,
)
from hubodo.emulator.chips.lsm6dso import (
    FIFO_CTRL1,
    FIFO_CTRL2,
    FIFO_CTRL3,
    FIFO_CTRL4,
    FIFO_TAG,
    TAP_CFG0,
    WORD_BYTES,
    Lsm6dso,
)
from hubodo.emulator.chips.registers import Register

CTRL1, CTRL2, CTRL3 = CTRL1_XL, CTRL2_G, CTRL3_C
CTRL6, CTRL8, FIFO_STATUS1, WAKE_UP_SRC, INTERNAL_FREQ = 0x15, 0x17, 0x1B, 0x45, 0x4F
FUNCTIONS_ENABLE, INACTIVITY_DUR = 0x50, 0x54

GYRO_DPS_PER_LSB = {0: 4.375e-3, 1: 8.75e-3, 2: 17.5e-3, 3: 35e-3, 4: 70e-3, 12: 140e-3}
ACCEL_G_PER_LSB = (0.061e-3, 0.122e-3, 0.244e-3, 0.488e-3)
WAKE_STEP_G = 7.8125e-3
_LARGEST_WAKE_STEP_G = 0.25
_MOST_RATE_CODE = 12

_STATUS_AND_DATA = {
    WHO_AM_I: "WHO_AM_I", 0x1A: "CTRL_STATUS", FIFO_STATUS1: "FIFO_STATUS1", 0x1C: "FIFO_STATUS2",
    0x1D: "ALL_INT_SRC", STATUS: "STATUS_REG", 0x1F: "RESERVED", 0x44: "UI_STATUS_REG_OIS",
    WAKE_UP_SRC: "WAKE_UP_SRC", 0x46: "TAP_SRC", 0x47: "D6D_SRC", INTERNAL_FREQ: "INTERNAL_FREQ",
    **{OUT_TEMP_L + i: f"OUT_{i:X}" for i in range(26)},
    **{TIMESTAMP0 + i: f"TIMESTAMP{i}" for i in range(4)},
    **{FIFO_TAG + i: f"FIFO_DATA_OUT_{i}" for i in range(WORD_BYTES)},
}  # fmt: skip
REGISTERS: dict[int, Register] = {
    0x01: Register("FUNC_CFG_ACCESS", 0x00, 0xCF),
    0x02: Register("PIN_CTRL", 0x23, 0xE0),
    0x03: Register("IF_CFG", 0x00, 0xFD),
    0x06: Register("ODR_TRIG_CFG", 0x00, 0xFF),
    FIFO_CTRL1: Register("FIFO_CTRL1", 0x00, 0xFF),
    FIFO_CTRL2: Register("FIFO_CTRL2", 0x00, 0xD7),
    FIFO_CTRL3: Register("FIFO_CTRL3", 0x00, 0xFF),
    FIFO_CTRL4: Register("FIFO_CTRL4", 0x00, 0xFF),
    0x0B: Register("COUNTER_BDR_REG1", 0x00, 0x63),
    0x0C: Register("COUNTER_BDR_REG2", 0x00, 0xFF),
    0x0D: Register("INT1_CTRL", 0x00, 0x7B),
    0x0E: Register("INT2_CTRL", 0x00, 0xFF),
    CTRL1: Register("CTRL1", 0x00, 0x7F),
    CTRL2: Register("CTRL2", 0x00, 0x7F),
    CTRL3: Register("CTRL3", 0x44, 0xC5),
    0x13: Register("CTRL4", 0x00, 0x1F),
    0x14: Register("CTRL5", 0x00, 0x07),
    CTRL6: Register("CTRL6", 0x00, 0x7F),
    0x16: Register("CTRL7", 0x00, 0x01),
    CTRL8: Register("CTRL8", 0x00, 0xEB),
    0x18: Register("CTRL9", 0x00, 0x7B),
    0x19: Register("CTRL10", 0x00, 0x4F),
    FUNCTIONS_ENABLE: Register("FUNCTIONS_ENABLE", 0x00, 0xCB),
    INACTIVITY_DUR: Register("INACTIVITY_DUR", 0x04, 0xFF),
    0x55: Register("INACTIVITY_THS", 0x00, 0x3F),
    TAP_CFG0: Register("TAP_CFG0", 0x00, 0x7F),
    0x57: Register("TAP_CFG1", 0x00, 0xFF),
    0x58: Register("TAP_CFG2", 0x00, 0x1F),
    0x59: Register("TAP_THS_6D", 0x00, 0xFF),
    0x5A: Register("TAP_DUR", 0x00, 0xFF),
    WAKE_UP_THS: Register("WAKE_UP_THS", 0x00, 0xFF),
    WAKE_UP_DUR: Register("WAKE_UP_DUR", 0x00, 0xEF),
    0x5D: Register("FREE_FALL", 0x00, 0xFF),
    MD1_CFG: Register("MD1_CFG", 0x00, 0xFF),
    0x5F: Register("MD2_CFG", 0x00, 0xFF),
    0x62: Register("HAODR_CFG", 0x00, 0x03),
    **{address: Register(name) for address, name in _STATUS_AND_DATA.items()},
}


class Lsm6dsv(Lsm6dso):
    """An LSM6DSV or LSM6DSV16X that is moved by `motion`.

    Register map and codes: ST DS13510, AN5763 and lsm6dsv16x_reg.h. Not modelled, besides what an LSM6DSO
    lacks: modes other than high performance, high-accuracy rates, 1.875 Hz, the channels for image
    stabilisation; such a mode or rate counts as an anomaly. Assumed: the FIFO, of 4.5 kB with compression by
    three, holds 256 words without it.
    """

    chip_name = "lsm6dsv"
    IDENTITY = 0x70
    REGISTERS = REGISTERS
    ODR_HZ = (0.0, 1.875, *(7680.0 / 2**n for n in range(10, -1, -1)))
    FIFO_STATUS, FIFO_WORDS = FIFO_STATUS1, 256
    TICKS_PER_SECOND = 46080.0
    RATE_CALIBRATION, FINE_STEP = INTERNAL_FREQ, 0.0013
    TIMESTAMP_ENABLE, INTERRUPTS_ENABLE = (FUNCTIONS_ENABLE, 0x40), (FUNCTIONS_ENABLE, 0x80)
    HAS_PARITY = False
    WAKE_SOURCE = WAKE_UP_SRC
    SAMPLING = (CTRL1, CTRL2, CTRL6, CTRL8)
    GYRO_DPS_PER_LSB = GYRO_DPS_PER_LSB

    def _rate_codes(self) -> tuple[int, int]:
        """Return the codes of the output data rates of accelerometer and gyro, 0 when off or not modelled."""
        codes = [self.values[register] for register in (CTRL1, CTRL2)]
        for register, code in zip((CTRL1, CTRL2), codes, strict=True):
            if code == 1 or code > _MOST_RATE_CODE:
                self._count_anomaly("unmodelled mode or rate in", register)
        accel_code, gyro_code = (0 if code == 1 or code > _MOST_RATE_CODE else code for code in codes)
        if gyro_code and self.values[CTRL6] & 0x0F not in self.GYRO_DPS_PER_LSB:
            self._count_anomaly("reserved range in", CTRL6)
            gyro_code = 0
        return accel_code, gyro_code

    @property
    def gyro_lsb(self) -> float:
        """Resolution of the gyro at the current range, rad/s per LSB."""
        return rad_per_lsb(self.GYRO_DPS_PER_LSB.get(self.values[CTRL6] & 0x0F, 1.0))

    @property
    def accel_lsb(self) -> float:
        """Resolution of the accelerometer at the current range, m/s² per LSB."""
        return accel_per_lsb(ACCEL_G_PER_LSB[self.values[CTRL8] & 3])

    def _wake_up_threshold(self) -> float:
        """Return the threshold of the wake-up detection in output words: its step is fixed, in g."""
        step_g = min(WAKE_STEP_G * (1 << (self.values[INACTIVITY_DUR] >> 4 & 7)), _LARGEST_WAKE_STEP_G)
        return (self.values[WAKE_UP_THS] & 0x3F) * step_g / ACCEL_G_PER_LSB[self.values[CTRL8] & 3]


class Lsm6dsv320x(Lsm6dsv):
    """An LSM6DSV320X (ST DS14623): another code for 4000 deg/s, none for 125; no high-g triad."""

    chip_name = "lsm6dsv320x"
    IDENTITY = 0x73
    REGISTERS = REGISTERS | {CTRL6: Register("CTRL6", 0x01, 0x77)}
    GYRO_DPS_PER_LSB = {code: GYRO_DPS_PER_LSB[code] for code in range(1, 5)} | {5: GYRO_DPS_PER_LSB[12]}
