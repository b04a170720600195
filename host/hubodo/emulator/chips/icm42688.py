"""Emulated ICM-42688-P: two banks, packets of 16 bytes with time stamps in its FIFO, wake on motion."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.emulator.chips.banks import BankedImu
from hubodo.emulator.chips.imu import Specimen, accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import RawWords, quantise
from hubodo.emulator.motion import Motion

DEVICE_CONFIG, FIFO_CONFIG, OUT = 0x11, 0x16, 0x1D
INT_STATUS, FIFO_COUNTH, FIFO_COUNTL, FIFO_DATA, INT_STATUS2 = 0x2D, 0x2E, 0x2F, 0x30, 0x37
SIGNAL_PATH_RESET, INTF_CONFIG0, INTF_CONFIG1, PWR_MGMT0 = 0x4B, 0x4C, 0x4D, 0x4E
GYRO_CONFIG0, ACCEL_CONFIG0, TMST_CONFIG, SMD_CONFIG, FIFO_CONFIG1 = 0x4F, 0x50, 0x54, 0x57, 0x5F
WHO_AM_I, REG_BANK_SEL = 0x75, 0x76
ACCEL_WOM_X_THR = 4 << 7 | 0x4A

PACKET_BYTES, FIFO_PACKETS, HEADER = 16, 128, 0x68
ODR_HZ = {
    3: 8000.0,
    4: 4000.0,
    5: 2000.0,
    6: 1000.0,
    7: 200.0,
    8: 100.0,
    9: 50.0,
    10: 25.0,
    11: 12.5,
    15: 500.0,
}
GYRO_RANGE_DPS = (2000.0, 1000.0, 500.0, 250.0, 125.0, 62.5, 31.25, 15.625)
ACCEL_RANGE_G = (16.0, 8.0, 4.0, 2.0)
LSB_PER_DEGREE, DEGREES_AT_ZERO = 132.48, 25.0
TICK_S = 32 / 30 * 1e-6
"""Unit of the time stamp, by the chip's own oscillator."""
_DATA_RDY, _FIFO_FULL, _RESET_DONE, _FIFO_FLUSH = 0x08, 0x02, 0x10, 0x02
_BOTH_LOW_NOISE, _COUNT_PACKETS, _STREAM, _PACKET_3 = 0x0F, 0x40, 1, 0x0F

_READ_ONLY_NAMES = {
    **{OUT + i: f"DATA_{i}" for i in range(14)},
    0x2B: "TMST_FSYNCH", 0x2C: "TMST_FSYNCL", INT_STATUS: "INT_STATUS", FIFO_COUNTH: "FIFO_COUNTH",
    FIFO_COUNTL: "FIFO_COUNTL", FIFO_DATA: "FIFO_DATA", INT_STATUS2: "INT_STATUS2", 0x38: "INT_STATUS3",
    WHO_AM_I: "WHO_AM_I",
}  # fmt: skip
REGISTERS: dict[int, Register] = {
    DEVICE_CONFIG: Register("DEVICE_CONFIG", 0x00, 0x11),
    0x13: Register("DRIVE_CONFIG", 0x05, 0x3F),
    0x14: Register("INT_CONFIG", 0x00, 0x3F),
    FIFO_CONFIG: Register("FIFO_CONFIG", 0x00, 0xC0),
    SIGNAL_PATH_RESET: Register("SIGNAL_PATH_RESET", 0x00, 0x6E),
    INTF_CONFIG0: Register("INTF_CONFIG0", 0x30, 0xF3),
    INTF_CONFIG1: Register("INTF_CONFIG1", 0x91, 0xDF),
    PWR_MGMT0: Register("PWR_MGMT0", 0x00, 0x3F),
    GYRO_CONFIG0: Register("GYRO_CONFIG0", 0x06, 0xEF),
    ACCEL_CONFIG0: Register("ACCEL_CONFIG0", 0x06, 0xEF),
    0x51: Register("GYRO_CONFIG1", 0x16, 0xEF),
    0x52: Register("GYRO_ACCEL_CONFIG0", 0x11, 0xFF),
    0x53: Register("ACCEL_CONFIG1", 0x0D, 0x1E),
    TMST_CONFIG: Register("TMST_CONFIG", 0x23, 0x3F),
    SMD_CONFIG: Register("SMD_CONFIG", 0x00, 0x0F),
    FIFO_CONFIG1: Register("FIFO_CONFIG1", 0x00, 0x7F),
    0x60: Register("FIFO_CONFIG2", 0x00, 0xFF),
    0x61: Register("FIFO_CONFIG3", 0x00, 0x0F),
    0x63: Register("INT_CONFIG0", 0x00, 0x3F),
    0x64: Register("INT_CONFIG1", 0x10, 0x70),
    0x65: Register("INT_SOURCE0", 0x10, 0x7F),
    0x66: Register("INT_SOURCE1", 0x00, 0x5F),
    REG_BANK_SEL: Register("REG_BANK_SEL", 0x00, 0x07),
    **{ACCEL_WOM_X_THR + axis: Register(f"ACCEL_WOM_{'XYZ'[axis]}_THR", 0x00, 0xFF) for axis in range(3)},
    **{address: Register(name) for address, name in _READ_ONLY_NAMES.items()},
}


class Icm42688(BankedImu):
    """An ICM-42688-P that is moved by `motion`.

    Register map, codes and packet 3 of the FIFO: TDK DS-000347. Not modelled: other packets, little-endian
    data, different rates of the two sensors (counted as anomalies), filters, interrupt pins, FSYNC.
    """

    chip_name = "icm42688"
    BANK_SELECT = REG_BANK_SEL

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x68) -> None:
        specimen = specimen or Specimen()
        self._sample = bytes(14)
        self._fifo = bytearray()
        self._interrupts = 0
        super().__init__(motion, specimen, address, REGISTERS, (WHO_AM_I, specimen.who_am_i or 0x47))

    def temperature_word(self, degrees: Array) -> RawWords:
        """Return temperature words, 132.48 LSB/°C and 0 at 25 °C."""
        return quantise((degrees - DEGREES_AT_ZERO) * LSB_PER_DEGREE, 1.0)

    def power_on(self, t: float) -> None:
        """Reset the registers at t, as power-up and soft reset do: both sensors off, FIFO empty."""
        super().power_on(t)
        self.clock.stop()
        self._sample = bytes(14)
        self._fifo.clear()
        self._interrupts = _RESET_DONE

    @property
    def gyro_lsb(self) -> float:
        """Resolution of the gyro at the current range, rad/s per LSB."""
        return rad_per_lsb(GYRO_RANGE_DPS[self.values[GYRO_CONFIG0] >> 5] / 32768)

    @property
    def accel_lsb(self) -> float:
        """Resolution of the accelerometer at the current range, m/s² per LSB."""
        return accel_per_lsb(ACCEL_RANGE_G[self.values[ACCEL_CONFIG0] >> 5 & 3] / 32768)

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == DEVICE_CONFIG and self.values[DEVICE_CONFIG] & 1:
            self.power_on(t)
        elif register in (PWR_MGMT0, GYRO_CONFIG0, ACCEL_CONFIG0):
            self._configure(t)
        elif register == SIGNAL_PATH_RESET:
            if self.values[SIGNAL_PATH_RESET] & _FIFO_FLUSH:
                self._fifo.clear()
            self.values[SIGNAL_PATH_RESET] = 0
        elif register == FIFO_CONFIG and not self.values[FIFO_CONFIG]:
            self._fifo.clear()
        elif register == INTF_CONFIG0 and self.values[INTF_CONFIG0] & 0x30 != 0x30:
            self._count_anomaly("unmodelled byte order in", register)

    def _configure(self, t: float) -> None:
        """Restart sampling with the current settings, or stop it."""
        self.clock.stop()
        if self.values[PWR_MGMT0] & 0x0F != _BOTH_LOW_NOISE:
            return
        codes = {self.values[GYRO_CONFIG0] & 15, self.values[ACCEL_CONFIG0] & 15}
        if len(codes) > 1 or not codes <= set(ODR_HZ):
            self._count_anomaly("unmodelled rates in", GYRO_CONFIG0)
            return
        self.start_sampling(t, ODR_HZ[codes.pop()], self.gyro_lsb, self.accel_lsb)

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        for when, words, temperature in self.clock.samples_until(t):
            swapped = bytearray(12)
            swapped[0::2], swapped[1::2] = words[1::2], words[0::2]
            previous, fresh = self._sample, bytes(swapped[6:] + swapped[:6])
            self._sample = temperature.to_bytes(2, "big", signed=True) + fresh
            self._interrupts |= _DATA_RDY
            self._detect_motion(previous)
            if self.values[FIFO_CONFIG] >> 6 == _STREAM and self.values[FIFO_CONFIG1] & 15 == _PACKET_3:
                self._store(when, fresh)

    def _detect_motion(self, previous: bytes) -> None:
        """Set the flags of the axes whose acceleration changed by more than the threshold (1 g / 256)."""
        if self.values[SMD_CONFIG] & 3 != 1 or not any(previous):
            return
        before, now = (np.frombuffer(b[2:8], ">i2").astype(int) for b in (previous, self._sample))
        step_g = np.abs(now - before) * self.accel_lsb / accel_per_lsb(1.0)
        for axis in range(3):
            if step_g[axis] > self.values[ACCEL_WOM_X_THR + axis] / 256:
                self.values[INT_STATUS2] |= 1 << axis

    def _store(self, when: float, sample: bytes) -> None:
        """Append a packet to the FIFO; overwrite the oldest when it is full."""
        ticks = int(when * (1 + self.specimen.odr_error) / TICK_S) & 0xFFFF
        self._fifo += bytes([HEADER]) + sample + bytes([0]) + ticks.to_bytes(2, "big")
        if len(self._fifo) > FIFO_PACKETS * PACKET_BYTES:
            del self._fifo[:PACKET_BYTES]
            self.fifo_dropped += 6
        if len(self._fifo) == FIFO_PACKETS * PACKET_BYTES:
            self._interrupts |= _FIFO_FULL

    def next_register(self, register: int) -> int:
        """Return the next register of a burst; FIFO_DATA repeats."""
        return register if register == FIFO_DATA else super().next_register(register)

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """Return a burst; the output registers hold one sample for its duration."""
        if self.pointer == FIFO_DATA:
            self._measure_until(t)
            data = bytes(self._fifo[:n])
            del self._fifo[:n]
            if len(data) < n:
                self.anomalies["read of empty FIFO"] += 1
            return data + b"\xff" * (n - len(data))
        if self.pointer >= OUT and self.pointer + n <= OUT + 14:
            self._measure_until(t)
            return self._sample[self.pointer - OUT :][:n]
        return super().read(t, n, byte_time)

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        self._measure_until(t)
        if register == INT_STATUS:
            status, self._interrupts = self._interrupts, 0
            return status
        if register == INT_STATUS2:
            status, self.values[INT_STATUS2] = self.values[INT_STATUS2], 0
            return status
        if OUT <= register < OUT + 14:
            return self._sample[register - OUT]
        if register in (FIFO_COUNTH, FIFO_COUNTL):
            unit = PACKET_BYTES if self.values[INTF_CONFIG0] & _COUNT_PACKETS else 1
            count = len(self._fifo) // unit
            if register == FIFO_COUNTL:
                self._count_high = count >> 8
                return count & 0xFF
            return self._count_high
        if register == FIFO_DATA:
            return self._fifo.pop(0) if self._fifo else 0xFF
        return self.values[register]

    _count_high = 0
