"""Emulated BMI270: off until its configuration is uploaded, little-endian, a FIFO of 2 kB without headers."""

from __future__ import annotations

from hubodo.arrays import Array
from hubodo.emulator.chips.bosch import BoschChip
from hubodo.emulator.chips.imu import Imu, Specimen, accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import RawWords, quantise
from hubodo.emulator.motion import Motion

CHIP_ID, STATUS, OUT, INTERNAL_STATUS, TEMPERATURE_0 = 0x00, 0x03, 0x0C, 0x21, 0x22
FIFO_LENGTH_0, FIFO_LENGTH_1, FIFO_DATA = 0x24, 0x25, 0x26
ACC_CONF, ACC_RANGE, GYR_CONF, GYR_RANGE, FIFO_CONFIG_0, FIFO_CONFIG_1 = 0x40, 0x41, 0x42, 0x43, 0x48, 0x49
INIT_CTRL, INIT_ADDR_0, INIT_ADDR_1, INIT_DATA = 0x59, 0x5B, 0x5C, 0x5E
PWR_CONF, PWR_CTRL, CMD = 0x7C, 0x7D, 0x7E

FIFO_BYTES, FRAME_BYTES, CONFIGURATION_BYTES = 2048, 12, 8192
CONFIGURATION_START = b"\xc8\x2e"
"""The first bytes of Bosch's configuration files, which are programs for the chip's own processor."""
ODR_HZ = {6: 25.0, 7: 50.0, 8: 100.0, 9: 200.0, 10: 400.0, 11: 800.0, 12: 1600.0}
GYRO_RANGE_DPS, ACCEL_RANGE_G = (2000.0, 1000.0, 500.0, 250.0, 125.0), (2.0, 4.0, 8.0, 16.0)
LSB_PER_DEGREE, DEGREES_AT_ZERO = 512.0, 23.0
_SOFT_RESET, _FIFO_FLUSH, _READY, _REJECTED = 0xB6, 0xB0, 0x01, 0x02
_DRDY_ACC, _DRDY_GYR, _SENSORS, _BOTH_HEADERLESS = 0x80, 0x40, 0x06, 0xC0

REGISTERS: dict[int, Register] = {
    CHIP_ID: Register("CHIP_ID"),
    0x02: Register("ERR_REG"),
    STATUS: Register("STATUS"),
    **{OUT + i: Register(f"DATA_{8 + i}") for i in range(12)},
    **{0x18 + i: Register(f"SENSORTIME_{i}") for i in range(3)},
    INTERNAL_STATUS: Register("INTERNAL_STATUS"),
    TEMPERATURE_0: Register("TEMPERATURE_0"),
    0x23: Register("TEMPERATURE_1"),
    FIFO_LENGTH_0: Register("FIFO_LENGTH_0"),
    FIFO_LENGTH_1: Register("FIFO_LENGTH_1"),
    FIFO_DATA: Register("FIFO_DATA"),
    ACC_CONF: Register("ACC_CONF", 0xA8, 0xFF),
    ACC_RANGE: Register("ACC_RANGE", 0x02, 0x03),
    GYR_CONF: Register("GYR_CONF", 0xA9, 0xFF),
    GYR_RANGE: Register("GYR_RANGE", 0x00, 0x0F),
    0x45: Register("FIFO_DOWNS", 0x88, 0xFF),
    FIFO_CONFIG_0: Register("FIFO_CONFIG_0", 0x02, 0x03),
    FIFO_CONFIG_1: Register("FIFO_CONFIG_1", 0x10, 0xFF),
    INIT_CTRL: Register("INIT_CTRL", 0x00, 0xFF),
    INIT_ADDR_0: Register("INIT_ADDR_0", 0x00, 0x0F),
    INIT_ADDR_1: Register("INIT_ADDR_1", 0x00, 0xFF),
    INIT_DATA: Register("INIT_DATA", 0x00, 0xFF),
    0x75: Register("RESERVED"),
    0x6B: Register("IF_CONF", 0x00, 0x31),
    PWR_CONF: Register("PWR_CONF", 0x03, 0x07),
    PWR_CTRL: Register("PWR_CTRL", 0x00, 0x0F),
    CMD: Register("CMD", 0x00, 0xFF),
}


class Bmi270(BoschChip, Imu):
    """A BMI270 that is moved by `motion`.

    Register map and formulas: Bosch BST-BMI270-DS000. `configuration` holds what a driver has uploaded; it is
    accepted when complete and when it begins as Bosch's do, and before that no sensor runs. Not modelled:
    FIFO frames with headers, features, the cross sensitivity of the gyro, different rates (counted).
    """

    chip_name = "bmi270"
    SPI_DUMMY_BYTES = 1
    OUTPUT, OUTPUT_BYTES, FIFO_REGISTER = OUT, 12, FIFO_DATA

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x68) -> None:
        specimen = specimen or Specimen()
        self._temperature = 0
        self.configuration = bytearray()
        super().__init__(motion, specimen, address, REGISTERS, (CHIP_ID, specimen.who_am_i or 0x24))

    def temperature_word(self, degrees: Array) -> RawWords:
        """Return temperature words, 512 LSB/°C and 0 at 23 °C."""
        return quantise((degrees - DEGREES_AT_ZERO) * LSB_PER_DEGREE, 1.0)

    def power_on(self, t: float) -> None:
        """Reset the registers at t, as power-up and soft reset do: the configuration is lost."""
        super().power_on(t)
        self.spi_is_active = False
        self.clock.stop()
        self.configuration = bytearray(CONFIGURATION_BYTES)
        self._received = 0

    @property
    def gyro_lsb(self) -> float:
        """Resolution of the gyro at the current range, rad/s per LSB."""
        return rad_per_lsb(GYRO_RANGE_DPS[min(self.values[GYR_RANGE] & 7, 4)] / 32768)

    @property
    def accel_lsb(self) -> float:
        """Resolution of the accelerometer at the current range, m/s² per LSB."""
        return accel_per_lsb(ACCEL_RANGE_G[self.values[ACC_RANGE]] / 32768)

    def write(self, t: float, data: bytes) -> None:
        """Receive a write; a burst to INIT_DATA goes to the address in INIT_ADDR."""
        if data and data[0] == INIT_DATA and not self.values[INIT_CTRL]:
            start = 2 * (self.values[INIT_ADDR_0] | self.values[INIT_ADDR_1] << 4)
            self.configuration[start : start + len(data) - 1] = data[1:]
            self._received += len(data) - 1
            return
        super().write(t, data)

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self.measure_until(t)
        if register == CMD:
            command, self.values[CMD] = self.values[CMD], 0
            if command == _SOFT_RESET:
                self.power_on(t)
            elif command == _FIFO_FLUSH:
                self._fifo.clear()
        elif register == INIT_CTRL and self.values[INIT_CTRL] & 1:
            is_complete = self._received == len(self.configuration) == CONFIGURATION_BYTES
            is_known = self.configuration.startswith(CONFIGURATION_START) and not self.values[PWR_CONF] & 1
            self.values[INTERNAL_STATUS] = _READY if is_complete and is_known else _REJECTED
        elif register in (ACC_CONF, ACC_RANGE, GYR_CONF, GYR_RANGE, PWR_CTRL):
            self._configure(t)
        elif register == FIFO_CONFIG_1 and self.values[FIFO_CONFIG_1] & 0x30:
            self._count_anomaly("unmodelled FIFO frames in", register)

    def _configure(self, t: float) -> None:
        """Restart sampling with the current settings, or stop it while a sensor is off."""
        self.clock.stop()
        if self.values[INTERNAL_STATUS] != _READY or self.values[PWR_CTRL] & _SENSORS != _SENSORS:
            return
        codes = {self.values[ACC_CONF] & 15, self.values[GYR_CONF] & 15}
        if len(codes) > 1 or not codes <= set(ODR_HZ):
            self._count_anomaly("unmodelled rates in", ACC_CONF)
            return
        self.start_sampling(t, ODR_HZ[codes.pop()], self.gyro_lsb, self.accel_lsb)

    def measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        for sample in self.clock.samples_until(t):
            _, words, self._temperature = sample
            self._sample = bytes(words[6:] + words[:6])
            self._data_ready = _DRDY_ACC | _DRDY_GYR
            if self.values[FIFO_CONFIG_1] == _BOTH_HEADERLESS:
                self._fifo += words
                if len(self._fifo) > FIFO_BYTES:
                    del self._fifo[:FRAME_BYTES]
                    self.fifo_dropped += 6

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        self.measure_until(t)
        if register == STATUS:
            return self._data_ready
        if OUT <= register < OUT + 12:
            self._data_ready &= ~(_DRDY_ACC if register < OUT + 6 else _DRDY_GYR)
            return self._sample[register - OUT]
        if register in (TEMPERATURE_0, TEMPERATURE_0 + 1):
            return self._temperature.to_bytes(2, "little", signed=True)[register - TEMPERATURE_0]
        if register in (FIFO_LENGTH_0, FIFO_LENGTH_1):
            return len(self._fifo) >> (8 if register == FIFO_LENGTH_1 else 0) & 0xFF
        if register in (0x18, 0x19, 0x1A):
            return int(t / 39.0625e-6) >> 8 * (register - 0x18) & 0xFF
        return self.values[register]
