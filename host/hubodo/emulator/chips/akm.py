"""Emulated AK8963 and AK09916: magnetometers inside an IMU, behind a switch between its two I2C buses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.magnetometer import Magnetometer
from hubodo.emulator.chips.registers import NotAcknowledged, Register
from hubodo.emulator.chips.sampling import quantise
from hubodo.emulator.motion import Motion

ADDRESS, FUSE_MODE, SENSITIVITY_X = 0x0C, 0x1F, 0x10
LSB_TESLA, MAX_WORD = 0.15e-6, 32752
_NEW, _SKIPPED, _OVERFLOW, _RESET = 0x01, 0x02, 0x08, 0x01


class InnerMagnetometer(Magnetometer):
    """A magnetometer inside an IMU; a subclass adds registers and modes.

    is_connected: returns True while the IMU connects its inner bus to the outer one.
    """

    IDENTITY: tuple[int, int]
    REGISTERS: dict[int, Register]
    STATUS: int
    """Register with the flag of a new sample; the field is behind it."""
    LAST: int
    """Register that ends a sample: until it is read the data do not change."""
    MODE: int
    RESET: int
    RATES_HZ: dict[int, float]
    """Rate by the value of MODE; other values are no continuous mode."""
    NODE_TO_CHIP: tuple[tuple[int, int, int], ...]
    """Rotation from node axes to those of this chip."""
    SENSITIVITY = (128, 128, 128)
    """Factory adjustment of each axis: a step is the nominal one times (128 + this) / 256."""

    def __init__(self, motion: Motion, specimen: Specimen | None, is_connected: Callable[[], bool]) -> None:
        self._is_connected = is_connected
        self._is_held = False
        super().__init__(
            motion, specimen, ADDRESS, self.REGISTERS, self.IDENTITY, lambda degrees: quantise(degrees, 1.0)
        )

    def power_on(self, t: float) -> None:
        """Reset the registers at t: powered down."""
        super().power_on(t)
        self._is_held = False

    def acknowledge(self, t: float) -> None:
        """Receive the address byte at t; raise NotAcknowledged while the IMU does not connect the buses."""
        if not self._is_connected():
            raise NotAcknowledged
        super().acknowledge(t)

    @property
    def lsb(self) -> float:
        """Nominal resolution, T per LSB."""
        return LSB_TESLA

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == self.RESET and self.values[self.RESET] & _RESET:
            self.power_on(t)
        elif register == self.MODE:
            self._configure(t)

    def _configure(self, t: float) -> None:
        """Start the continuous mode, or stop."""
        self.clock.stop()
        rate_hz = self.RATES_HZ.get(self.values[self.MODE])
        if rate_hz is None:
            return
        rotation = np.array(self.NODE_TO_CHIP, dtype=float).T
        lsb = LSB_TESLA * (128 + np.array(self.SENSITIVITY, dtype=float)) / 256
        self.clock.start(
            t,
            rate_hz,
            lambda times: np.clip(
                np.rint(self.motion.magnetic_field(times) @ rotation / lsb), -MAX_WORD, MAX_WORD
            ).astype(np.int16),
            lsb,
        )

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t."""
        for sample in self.clock.samples_until(t):
            if self._is_held:
                self._status |= _SKIPPED
                continue
            self._sample = sample[1]
            self._status = _NEW | (_SKIPPED if self._status & _NEW else 0)

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        self._measure_until(t)
        if register == self.STATUS:
            return self._status
        if self.STATUS < register <= self.STATUS + 6:
            self._status, self._is_held = 0, True
            return self._sample[register - self.STATUS - 1]
        if register == self.LAST:
            self._status, self._is_held = 0, False
            words = np.frombuffer(self._sample, "<i2").astype(int)
            return self.values[register] | (_OVERFLOW if np.abs(words).max() >= MAX_WORD else 0)
        return self.values[register]


class Ak09916(InnerMagnetometer):
    """The AK09916 of an ICM-20948 (TDK DS-000189): x is that of the IMU, y and z are opposite."""

    IDENTITY = (0x01, 0x09)
    STATUS, LAST, MODE, RESET = 0x10, 0x18, 0x31, 0x32
    RATES_HZ = {0x02: 10.0, 0x04: 20.0, 0x06: 50.0, 0x08: 100.0}
    NODE_TO_CHIP = ((1, 0, 0), (0, -1, 0), (0, 0, -1))
    REGISTERS = {
        0x00: Register("WIA1", 0x48),
        0x01: Register("WIA2", 0x09),
        STATUS: Register("ST1"),
        **{0x11 + i: Register(f"H_{i}") for i in range(6)},
        0x17: Register("TMPS"),
        LAST: Register("ST2"),
        MODE: Register("CNTL2", 0x00, 0x1F),
        RESET: Register("CNTL3", 0x00, 0x01),
    }


class Ak8963(InnerMagnetometer):
    """The AK8963 of an MPU-9250 (RM-MPU-9250A-00): x and y exchanged, z opposite, sensitivity adjusted."""

    IDENTITY = (0x00, 0x48)
    STATUS, LAST, MODE, RESET = 0x02, 0x09, 0x0A, 0x0B
    RATES_HZ = {0x12: 8.0, 0x16: 100.0}
    NODE_TO_CHIP = ((0, 1, 0), (1, 0, 0), (0, 0, -1))
    SENSITIVITY = (176, 178, 166)
    REGISTERS = {
        0x00: Register("WIA", 0x48),
        0x01: Register("INFO"),
        STATUS: Register("ST1"),
        **{0x03 + i: Register(f"H_{i}") for i in range(6)},
        LAST: Register("ST2", 0x10),
        MODE: Register("CNTL1", 0x00, 0x1F),
        RESET: Register("CNTL2", 0x00, 0x01),
        **{SENSITIVITY_X + i: Register(f"ASA_{i}") for i in range(3)},
    }

    def read_register(self, t: float, register: int) -> int:
        """Return one byte; the sensitivity is accessible in its mode alone."""
        if SENSITIVITY_X <= register < SENSITIVITY_X + 3:
            is_open = self.values[self.MODE] == FUSE_MODE
            return self.SENSITIVITY[register - SENSITIVITY_X] if is_open else 0
        return super().read_register(t, register)
