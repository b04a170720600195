"""Emulated ICM-20948: four banks of registers, big-endian, a FIFO of 512 bytes with a latched count."""

from __future__ import annotations

from hubodo.arrays import Array
from hubodo.emulator.chips.akm import Ak09916
from hubodo.emulator.chips.banks import BankedImu
from hubodo.emulator.chips.imu import Specimen, accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import RawWords, quantise
from hubodo.emulator.motion import Motion

WHO_AM_I, USER_CTRL, LP_CONFIG, PWR_MGMT_1, PWR_MGMT_2 = 0x00, 0x03, 0x05, 0x06, 0x07
INT_PIN_CFG, INT_STATUS_1, INT_STATUS_2, OUT = 0x0F, 0x1A, 0x1B, 0x2D
FIFO_EN_2, FIFO_RST, FIFO_COUNTH, FIFO_COUNTL, FIFO_R_W, REG_BANK_SEL = 0x67, 0x68, 0x70, 0x71, 0x72, 0x7F
_BANK_2 = 2 << 7
GYRO_SMPLRT_DIV, GYRO_CONFIG_1, ODR_ALIGN_EN = _BANK_2, _BANK_2 | 0x01, _BANK_2 | 0x09
ACCEL_SMPLRT_DIV_1, ACCEL_SMPLRT_DIV_2, ACCEL_CONFIG = _BANK_2 | 0x10, _BANK_2 | 0x11, _BANK_2 | 0x14

FIFO_BYTES, BASE_HZ = 512, 1125.0
GYRO_RANGE_DPS, ACCEL_RANGE_G = (250.0, 500.0, 1000.0, 2000.0), (2.0, 4.0, 8.0, 16.0)
LSB_PER_DEGREE, DEGREES_AT_ZERO = 333.87, 21.0
_DEVICE_RESET, _SLEEP, _DATA_READY, _OVERFLOW, _FIFO_ON, _ALL_AXES = 0x80, 0x40, 0x01, 0x01, 0x40, 0x1E
_BYPASS, _MASTER_ON = 0x02, 0x20

REGISTERS: dict[int, Register] = {
    WHO_AM_I: Register("WHO_AM_I"),
    USER_CTRL: Register("USER_CTRL", 0x00, 0xFE),
    LP_CONFIG: Register("LP_CONFIG", 0x40, 0x70),
    PWR_MGMT_1: Register("PWR_MGMT_1", 0x41, 0xEF),
    PWR_MGMT_2: Register("PWR_MGMT_2", 0x00, 0x3F),
    INT_PIN_CFG: Register("INT_PIN_CFG", 0x00, 0xFE),
    0x10: Register("INT_ENABLE", 0x00, 0x8F),
    0x11: Register("INT_ENABLE_1", 0x00, 0x01),
    INT_STATUS_1: Register("INT_STATUS_1"),
    INT_STATUS_2: Register("INT_STATUS_2"),
    **{OUT + i: Register(f"OUT_{i:X}") for i in range(14)},
    0x66: Register("FIFO_EN_1", 0x00, 0x0F),
    FIFO_EN_2: Register("FIFO_EN_2", 0x00, 0x1F),
    FIFO_RST: Register("FIFO_RST", 0x00, 0x1F),
    0x69: Register("FIFO_MODE", 0x00, 0x1F),
    FIFO_COUNTH: Register("FIFO_COUNTH"),
    FIFO_COUNTL: Register("FIFO_COUNTL"),
    FIFO_R_W: Register("FIFO_R_W", 0x00, 0xFF),
    0x75: Register("RESERVED"),
    REG_BANK_SEL: Register("REG_BANK_SEL", 0x00, 0x30),
    GYRO_SMPLRT_DIV: Register("GYRO_SMPLRT_DIV", 0x00, 0xFF),
    GYRO_CONFIG_1: Register("GYRO_CONFIG_1", 0x01, 0x3F),
    ODR_ALIGN_EN: Register("ODR_ALIGN_EN", 0x00, 0x01),
    ACCEL_SMPLRT_DIV_1: Register("ACCEL_SMPLRT_DIV_1", 0x00, 0x0F),
    ACCEL_SMPLRT_DIV_2: Register("ACCEL_SMPLRT_DIV_2", 0x00, 0xFF),
    ACCEL_CONFIG: Register("ACCEL_CONFIG", 0x01, 0x3F),
}


class Icm20948(BankedImu):
    """An ICM-20948 that is moved by `motion`.

    Register map and formulas: TDK DS-000189. Not modelled: DMP, filters, low-power modes, and
    different rates of the two sensors, which count as an anomaly.
    """

    chip_name = "icm20948"
    BANK_SELECT, BANK_SHIFT, BANK_MASK = REG_BANK_SEL, 4, 3

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x68) -> None:
        specimen = specimen or Specimen()
        self._sample = bytes(14)
        self._fifo = bytearray()
        self._interrupts = [0, 0]
        self._count_latch = 0
        self.magnetometer = Ak09916(motion, specimen, self._connects_buses)
        self.companions = (self.magnetometer,)
        super().__init__(motion, specimen, address, REGISTERS, (WHO_AM_I, specimen.who_am_i or 0xEA))

    def _connects_buses(self) -> bool:
        return bool(self.values[INT_PIN_CFG] & _BYPASS and not self.values[USER_CTRL] & _MASTER_ON)

    def temperature_word(self, degrees: Array) -> RawWords:
        """Return temperature words, 333.87 LSB/°C and 0 at 21 °C."""
        return quantise((degrees - DEGREES_AT_ZERO) * LSB_PER_DEGREE, 1.0)

    def power_on(self, t: float) -> None:
        """Reset the registers at t, as power-up and DEVICE_RESET do: asleep, bank 0."""
        super().power_on(t)
        self.clock.stop()
        self._sample = bytes(14)
        self._interrupts = [0, 0]
        self._fifo.clear()

    @property
    def gyro_lsb(self) -> float:
        """Resolution of the gyro at the current range, rad/s per LSB."""
        return rad_per_lsb(GYRO_RANGE_DPS[self.values[GYRO_CONFIG_1] >> 1 & 3] / 32768)

    @property
    def accel_lsb(self) -> float:
        """Resolution of the accelerometer at the current range, m/s² per LSB."""
        return accel_per_lsb(ACCEL_RANGE_G[self.values[ACCEL_CONFIG] >> 1 & 3] / 32768)

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == PWR_MGMT_1 and self.values[PWR_MGMT_1] & _DEVICE_RESET:
            self.power_on(t)
        elif register == PWR_MGMT_1 or register >= _BANK_2:
            self._configure(t)
        elif register == FIFO_RST and self.values[FIFO_RST]:
            self._fifo.clear()

    def _configure(self, t: float) -> None:
        """Restart sampling with the current settings, or stop it when asleep."""
        self.clock.stop()
        if self.values[PWR_MGMT_1] & _SLEEP:
            return
        divider = self.values[GYRO_SMPLRT_DIV]
        if divider != self.values[ACCEL_SMPLRT_DIV_1] << 8 | self.values[ACCEL_SMPLRT_DIV_2]:
            # A driver sets the two rates one after the other; in between both sensors have the gyro's rate.
            self.anomalies["rates differ"] += 1
        self.start_sampling(t, BASE_HZ / (1 + divider), self.gyro_lsb, self.accel_lsb)

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        for _, words, temperature in self.clock.samples_until(t):
            swapped = bytearray(12)
            swapped[0::2], swapped[1::2] = words[1::2], words[0::2]
            self._sample = bytes(swapped[6:] + swapped[:6]) + temperature.to_bytes(2, "big", signed=True)
            self._interrupts[0] |= _DATA_READY
            if self.values[FIFO_EN_2] == _ALL_AXES and self.values[USER_CTRL] & _FIFO_ON:
                self._fifo += self._sample[:12]
                excess = len(self._fifo) - FIFO_BYTES
                if excess > 0:
                    del self._fifo[:excess]
                    self.fifo_dropped += (excess + 1) // 2
                    self._interrupts[1] |= _OVERFLOW

    def next_register(self, register: int) -> int:
        """Return the next register of a burst; FIFO_R_W repeats."""
        return register if register == FIFO_R_W else super().next_register(register)

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """Return a burst; the output registers hold one sample for its duration."""
        if self.pointer == FIFO_R_W:
            self._measure_until(t)
            data = bytes(self._fifo[:n])
            del self._fifo[:n]
            if len(data) < n:
                self.anomalies["read of empty FIFO"] += 1
            return data + bytes(n - len(data))
        if self.pointer >= OUT and self.pointer + n <= OUT + 14:
            self._measure_until(t)
            return self._sample[self.pointer - OUT :][:n]
        return super().read(t, n, byte_time)

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        self._measure_until(t)
        if register in (INT_STATUS_1, INT_STATUS_2):
            which = register - INT_STATUS_1
            status, self._interrupts[which] = self._interrupts[which], 0
            return status
        if OUT <= register < OUT + 14:
            return self._sample[register - OUT]
        if register == FIFO_COUNTH:
            self._count_latch = len(self._fifo)
            return self._count_latch >> 8
        if register == FIFO_COUNTL:
            return self._count_latch & 0xFF
        return self.values[register]
