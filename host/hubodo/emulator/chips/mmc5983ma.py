"""Emulated MMC5983MA magnetometer: unsigned big-endian samples, control registers that cannot be read."""

from __future__ import annotations

import numpy as np

from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.magnetometer import TESLA_PER_GAUSS, Magnetometer
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import quantise
from hubodo.emulator.motion import Motion

OUT, XYZ_OUT_2, T_OUT, STATUS, PRODUCT_ID = 0x00, 0x06, 0x07, 0x08, 0x2F
CONTROL_0, CONTROL_1, CONTROL_2, CONTROL_3 = 0x09, 0x0A, 0x0B, 0x0C
LSB_PER_GAUSS, ZERO_FIELD = 4096.0, 32768
RATE_HZ = (0.0, 1.0, 10.0, 20.0, 50.0, 100.0, 200.0, 1000.0)
MAX_RATE_HZ = (100.0, 200.0, 200.0, 1000.0)
"""Highest rate by bandwidth code."""
_DONE, _OTP_READ_DONE, _SW_RESET, _CONTINUOUS = 0x01, 0x10, 0x80, 0x08

REGISTERS: dict[int, Register] = {
    **{OUT + i: Register(f"OUT_{i}") for i in range(6)},
    XYZ_OUT_2: Register("XYZ_OUT_2"),
    T_OUT: Register("T_OUT"),
    STATUS: Register("STATUS", _OTP_READ_DONE, 0x03),
    CONTROL_0: Register("CONTROL_0", 0x00, 0x7F),
    CONTROL_1: Register("CONTROL_1", 0x00, 0x9F),
    CONTROL_2: Register("CONTROL_2", 0x00, 0xFF),
    CONTROL_3: Register("CONTROL_3", 0x00, 0x46),
    PRODUCT_ID: Register("PRODUCT_ID", 0x30),
}


class Mmc5983ma(Magnetometer):
    """An MMC5983MA in the magnetic field of `motion`, in node axes.

    Register map and codes: Memsic MMC5983MA data sheet, revision A. Not modelled: the offset that set and
    reset cancel, the two lowest of 18 bits, single measurements.
    """

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x30) -> None:
        super().__init__(
            motion, specimen, address, REGISTERS, (PRODUCT_ID, 0x30), lambda degrees: quantise(degrees, 0.8)
        )

    def power_on(self, t: float) -> None:
        """Reset the registers at t: a field of zero, no samples until the chip is configured."""
        super().power_on(t)
        self._sample = bytes([0x80, 0x00] * 3)

    @property
    def lsb(self) -> float:
        """Resolution of the upper 16 bits, T per LSB."""
        return TESLA_PER_GAUSS / LSB_PER_GAUSS

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == STATUS:
            # Writing 1 clears a flag.
            self._status &= ~self.values[STATUS]
            self.values[STATUS] = _OTP_READ_DONE
        elif register == CONTROL_1 and self.values[CONTROL_1] & _SW_RESET:
            self.power_on(t)
        elif register in (CONTROL_1, CONTROL_2):
            self._configure(t)

    def _configure(self, t: float) -> None:
        """Restart the measurements with the current rate, or stop them."""
        rate_hz = RATE_HZ[self.values[CONTROL_2] & 7]
        self.clock.stop()
        if not self.values[CONTROL_2] & _CONTINUOUS or not rate_hz:
            return
        if rate_hz > MAX_RATE_HZ[self.values[CONTROL_1] & 3]:
            self._count_anomaly("rate beyond the bandwidth in", CONTROL_2)
            return
        self.start_measuring(t, rate_hz)

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t."""
        for sample in self.clock.samples_until(t):
            words = np.frombuffer(sample[1], "<i2").astype(np.int32) + ZERO_FIELD
            self._sample = words.astype(">u2").tobytes()
            self._status |= _DONE

    def read_register(self, t: float, register: int) -> int:
        """Return one byte; control registers read 0."""
        self._measure_until(t)
        if register == STATUS:
            return self._status | _OTP_READ_DONE
        if OUT <= register < OUT + 6:
            return self._sample[register - OUT]
        return 0 if register in (CONTROL_0, CONTROL_1, CONTROL_2, CONTROL_3) else self.values[register]
