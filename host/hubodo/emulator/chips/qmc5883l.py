"""Emulated QMC5883L magnetometer: in standby at reset, status cleared by reading data."""

from __future__ import annotations

import numpy as np

from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.magnetometer import TESLA_PER_GAUSS, Magnetometer
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import quantise
from hubodo.emulator.motion import Motion

OUT, STATUS, TEMP_OUT, CONTROL_1, CONTROL_2, PERIOD, CHIP_ID = 0x00, 0x06, 0x07, 0x09, 0x0A, 0x0B, 0x0D
LSB_PER_GAUSS = (12000.0, 3000.0)
ODR_HZ = (10.0, 50.0, 100.0, 200.0)
_DATA_READY, _OVERFLOW, _SKIPPED = 0x01, 0x02, 0x04
_SOFT_RESET, _ROLL_OVER = 0x80, 0x40

REGISTERS: dict[int, Register] = {
    **{OUT + i: Register(f"OUT_{i}") for i in range(6)},
    STATUS: Register("STATUS"),
    TEMP_OUT: Register("TEMP_OUT_L"),
    TEMP_OUT + 1: Register("TEMP_OUT_H"),
    CONTROL_1: Register("CONTROL_1", 0x00, 0xFF),
    CONTROL_2: Register("CONTROL_2", 0x00, 0xC1),
    PERIOD: Register("SET_RESET_PERIOD", 0x00, 0xFF),
    CHIP_ID: Register("CHIP_ID", 0xFF),
}


class Qmc5883l(Magnetometer):
    """A QMC5883L in the magnetic field of `motion`, in node axes.

    Register map, reset values and codes: QST QMC5883L data sheet 1.0. The sensitivity is that of the data
    sheet; hard-iron offsets, temperature and the quality of a period other than 0x01 are not modelled.
    """

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x0D) -> None:
        super().__init__(
            motion, specimen, address, REGISTERS, (CHIP_ID, 0xFF), lambda degrees: quantise(degrees, 0.01)
        )

    @property
    def lsb(self) -> float:
        """Resolution at the current range, T per LSB."""
        return TESLA_PER_GAUSS / LSB_PER_GAUSS[self.values[CONTROL_1] >> 4 & 1]

    def next_register(self, register: int) -> int:
        """Return the next register; with ROL_PNT a burst stays within the data."""
        if self.values[CONTROL_2] & _ROLL_OVER and register == STATUS:
            return OUT
        return register + 1

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == CONTROL_2 and self.values[CONTROL_2] & _SOFT_RESET:
            self.power_on(t)
        elif register == CONTROL_1:
            if self.values[CONTROL_1] & 3 == 1:
                self.start_measuring(t, ODR_HZ[self.values[CONTROL_1] >> 2 & 3])
            else:
                self.clock.stop()

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t."""
        for sample in self.clock.samples_until(t):
            self._sample = sample[1]
            saturated = np.abs(np.frombuffer(self._sample, "<i2").astype(int)).max() >= 32767
            skipped = _SKIPPED if self._status & _DATA_READY else 0
            self._status = _DATA_READY | skipped | (_OVERFLOW if saturated else 0)

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        if register == STATUS:
            self._measure_until(t)
            return self._status
        if OUT <= register < OUT + 6:
            if register == OUT:
                self._measure_until(t)
            self._status = 0
            return self._sample[register - OUT]
        return self.values[register]
