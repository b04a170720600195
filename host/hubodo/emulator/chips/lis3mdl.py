"""Emulated LIS3MDL magnetometer: powered down at reset, burst reads need the MSB of the sub-address."""

from __future__ import annotations

from hubodo.arrays import Array
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.magnetometer import TESLA_PER_GAUSS, Magnetometer
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import RawWords, quantise
from hubodo.emulator.motion import Motion

WHO_AM_I, CTRL1, CTRL2, CTRL3, CTRL4, CTRL5 = 0x0F, 0x20, 0x21, 0x22, 0x23, 0x24
STATUS, OUT, TEMP_OUT = 0x27, 0x28, 0x2E
LSB_PER_GAUSS = (6842.0, 3421.0, 2281.0, 1711.0)
ODR_HZ = (0.625, 1.25, 2.5, 5.0, 10.0, 20.0, 40.0, 80.0)
FAST_ODR_HZ = (1000.0, 560.0, 300.0, 155.0)
_REBOOT, _SOFT_RST, _BDU = 0x08, 0x04, 0x40
_CONTINUOUS, _SINGLE = 0, 1

REGISTERS: dict[int, Register] = {
    **{0x05 + i: Register(f"OFFSET_{i}", 0x00, 0xFF) for i in range(6)},
    WHO_AM_I: Register("WHO_AM_I"),
    CTRL1: Register("CTRL_REG1", 0x10, 0xFF),
    CTRL2: Register("CTRL_REG2", 0x00, 0x6C),
    CTRL3: Register("CTRL_REG3", 0x03, 0x27),
    CTRL4: Register("CTRL_REG4", 0x00, 0x0E),
    CTRL5: Register("CTRL_REG5", 0x00, 0xC0),
    STATUS: Register("STATUS_REG"),
    **{OUT + i: Register(f"OUT_{i}") for i in range(6)},
    TEMP_OUT: Register("TEMP_OUT_L"),
    TEMP_OUT + 1: Register("TEMP_OUT_H"),
    0x30: Register("INT_CFG", 0xE8, 0xEF),
    0x31: Register("INT_SRC"),
    0x32: Register("INT_THS_L", 0x00, 0xFF),
    0x33: Register("INT_THS_H", 0x00, 0x7F),
}


class Lis3mdl(Magnetometer):
    """A LIS3MDL in the magnetic field of `motion`, in node axes.

    Register map, reset values and codes: ST DocID024204. Hard-iron offsets and self-test are not modelled.
    """

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x1E) -> None:
        self._auto_increment, self._temperature = False, 0
        super().__init__(motion, specimen, address, REGISTERS, (WHO_AM_I, 0x3D), self._temperature_word)

    @staticmethod
    def _temperature_word(degrees: Array) -> RawWords:
        """Return temperature words, 8 LSB/°C and 0 at 25 °C."""
        return quantise((degrees - 25.0) * 8.0, 1.0)

    def power_on(self, t: float) -> None:
        """Reset the registers at t: operating mode power-down, no samples."""
        super().power_on(t)
        self._temperature = 0

    @property
    def lsb(self) -> float:
        """Resolution at the current range, T per LSB."""
        return TESLA_PER_GAUSS / LSB_PER_GAUSS[self.values[CTRL2] >> 5 & 3]

    @property
    def odr_hz(self) -> float:
        """Nominal output data rate of CTRL_REG1, Hz."""
        control = self.values[CTRL1]
        return FAST_ODR_HZ[control >> 5 & 3] if control & 2 else ODR_HZ[control >> 2 & 7]

    def set_pointer(self, sub_address: int) -> None:
        """Receive the sub-address byte; its bit 7 selects auto-increment, unlike in the LSM6 family."""
        self._auto_increment = bool(sub_address & 0x80)
        self.pointer = sub_address & 0x7F

    def next_register(self, register: int) -> int:
        """Return the next register with auto-increment, else the same one."""
        return (register + 1) & 0x7F if self._auto_increment else register

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == CTRL2 and self.values[CTRL2] & (_SOFT_RST | _REBOOT):
            self.power_on(t)
        elif register in (CTRL1, CTRL2, CTRL3):
            if self.values[CTRL3] & 3 in (_CONTINUOUS, _SINGLE):
                self.start_measuring(t, self.odr_hz)
            else:
                self.clock.stop()

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t."""
        for sample in self.clock.samples_until(t):
            _, self._sample, self._temperature = sample
            self._status = 0xFF if self._status & 0x08 else 0x0F
            if self.values[CTRL3] & 3 == _SINGLE:
                self.values[CTRL3] |= 3
                self.clock.stop()

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        if not (self.values[CTRL5] & _BDU and register % 2 == 1 and OUT <= register < OUT + 6):
            self._measure_until(t)
        if register == STATUS:
            return self._status
        if OUT <= register < OUT + 6:
            axis, is_high_byte = divmod(register - OUT, 2)
            if is_high_byte:
                self._status &= ~(0x11 << axis)
                if not self._status & 0x07:
                    self._status = 0
            return self._sample[register - OUT]
        if register in (TEMP_OUT, TEMP_OUT + 1):
            return self._temperature.to_bytes(2, "little", signed=True)[register - TEMP_OUT]
        return self.values[register]

    def quantised_samples(self) -> RawWords:
        """Return all samples so far, (n, 3) int16."""
        return self.truth().raw
