"""Emulated MPU-6050 and MPU-6500: asleep at reset, big-endian, 1024-byte FIFO with a latched count."""

from __future__ import annotations

from hubodo.arrays import Array
from hubodo.emulator.chips.akm import Ak8963
from hubodo.emulator.chips.imu import Imu, Specimen, accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import RawWords, quantise
from hubodo.emulator.motion import Motion

SMPLRT_DIV, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, ACCEL_CONFIG2 = 0x19, 0x1A, 0x1B, 0x1C, 0x1D
FIFO_EN, INT_PIN_CFG, INT_ENABLE, INT_STATUS = 0x23, 0x37, 0x38, 0x3A
OUT, USER_CTRL, PWR_MGMT_1, PWR_MGMT_2 = 0x3B, 0x6A, 0x6B, 0x6C
FIFO_COUNT_H, FIFO_COUNT_L, FIFO_R_W, WHO_AM_I = 0x72, 0x73, 0x74, 0x75

GYRO_LSB_PER_DPS = (131.0, 65.5, 32.8, 16.4)
ACCEL_LSB_PER_G = (16384.0, 8192.0, 4096.0, 2048.0)
_DEVICE_RESET, _SLEEP = 0x80, 0x40
_FIFO_ENABLE, _FIFO_RESET = 0x40, 0x04
_INT_DATA_READY, _INT_FIFO_OVERFLOW = 0x01, 0x10
_FIFO_EN_ACCEL, _FIFO_EN_TEMPERATURE, _FIFO_EN_GYRO = 0x08, 0x80, (0x40, 0x20, 0x10)
_BYPASS, _MASTER_ON = 0x02, 0x20

_COMMON_REGISTERS: dict[int, Register] = {
    0x00: Register("RESERVED"),
    **{register: Register(f"SELF_TEST_{register:02X}", 0x00, 0xFF) for register in range(0x0D, 0x11)},
    **{0x13 + i: Register(f"OFFSET_{i}", 0x00, 0xFF) for i in range(6)},
    SMPLRT_DIV: Register("SMPLRT_DIV", 0x00, 0xFF),
    CONFIG: Register("CONFIG", 0x00, 0x7F),
    GYRO_CONFIG: Register("GYRO_CONFIG", 0x00, 0xFB),
    ACCEL_CONFIG: Register("ACCEL_CONFIG", 0x00, 0xF8),
    0x1F: Register("MOT_THR", 0x00, 0xFF),
    FIFO_EN: Register("FIFO_EN", 0x00, 0xFF),
    INT_PIN_CFG: Register("INT_PIN_CFG", 0x00, 0xFF),
    INT_ENABLE: Register("INT_ENABLE", 0x00, 0x79),
    INT_STATUS: Register("INT_STATUS"),
    **{OUT + i: Register(f"OUT_{i:X}") for i in range(14)},
    0x68: Register("SIGNAL_PATH_RESET", 0x00, 0x07),
    USER_CTRL: Register("USER_CTRL", 0x00, 0xF7),
    PWR_MGMT_1: Register("PWR_MGMT_1", 0x40, 0xEF),
    PWR_MGMT_2: Register("PWR_MGMT_2", 0x00, 0xFF),
    FIFO_COUNT_H: Register("FIFO_COUNT_H"),
    FIFO_COUNT_L: Register("FIFO_COUNT_L"),
    FIFO_R_W: Register("FIFO_R_W", 0x00, 0xFF),
    WHO_AM_I: Register("WHO_AM_I"),
}


class Mpu6050(Imu):
    """An MPU-6050 that is moved by `motion`.

    Register map and formulas: InvenSense RM-MPU-6000A and PS-MPU-6000A. Not modelled: auxiliary bus,
    self-test, motion detection, and the frequency response of the DLPF; its code only sets the base rate of
    the gyro.
    """

    chip_name = "mpu6050"
    IDENTITY = 0x68
    LSB_PER_DEGREE, DEGREES_AT_ZERO = 340.0, 36.53
    FIFO_BYTES = 1024
    EXTRA_REGISTERS: dict[int, Register] = {}

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x68) -> None:
        specimen = specimen or Specimen()
        self._sample = bytes(14)
        self._interrupts = 0
        self._fifo = bytearray()
        self._count_latch = 0
        super().__init__(
            motion,
            specimen,
            address,
            _COMMON_REGISTERS | self.EXTRA_REGISTERS,
            (WHO_AM_I, specimen.who_am_i or self.IDENTITY),
        )

    def temperature_word(self, degrees: Array) -> RawWords:
        """Return the words (T - AT_ZERO) PER_DEGREE for temperatures T in °C."""
        return quantise((degrees - self.DEGREES_AT_ZERO) * self.LSB_PER_DEGREE, 1.0)

    def power_on(self, t: float) -> None:
        """Reset the registers at t, as power-up and DEVICE_RESET do."""
        super().power_on(t)
        self.values[PWR_MGMT_1] = self.PWR_MGMT_1_RESET
        self.clock.stop()
        self._sample, self._interrupts = bytes(14), 0
        self._fifo.clear()
        self._count_latch = 0
        if not self.values[PWR_MGMT_1] & _SLEEP:
            self._configure(t)

    PWR_MGMT_1_RESET = 0x40

    @property
    def gyro_lsb(self) -> float:
        """Resolution of the gyro at the current range, rad/s per LSB."""
        return rad_per_lsb(1.0 / GYRO_LSB_PER_DPS[self.values[GYRO_CONFIG] >> 3 & 3])

    @property
    def accel_lsb(self) -> float:
        """Resolution of the accelerometer at the current range, m/s² per LSB."""
        return accel_per_lsb(1.0 / ACCEL_LSB_PER_G[self.values[ACCEL_CONFIG] >> 3 & 3])

    @property
    def sample_hz(self) -> float:
        """Nominal sample rate, Hz: 8 kHz (DLPF code 0 or 7) or 1 kHz, divided by 1 + SMPLRT_DIV."""
        base = 8000.0 if self.values[CONFIG] & 7 in (0, 7) else 1000.0
        return base / (1 + self.values[SMPLRT_DIV])

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == PWR_MGMT_1 and self.values[PWR_MGMT_1] & _DEVICE_RESET:
            self.power_on(t)
        elif register in (SMPLRT_DIV, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, PWR_MGMT_1):
            self._configure(t)
        elif register == USER_CTRL and self.values[USER_CTRL] & _FIFO_RESET:
            self.values[USER_CTRL] &= ~_FIFO_RESET & 0xFF
            self._fifo.clear()
        elif register == FIFO_EN and self.values[FIFO_EN] & 0x07:
            self._count_anomaly("unmodelled FIFO set in", register)

    def _configure(self, t: float) -> None:
        """Restart sampling with the current settings, or stop it when asleep."""
        if self.values[PWR_MGMT_1] & _SLEEP:
            self.clock.stop()
        else:
            self.start_sampling(t, self.sample_hz, self.gyro_lsb, self.accel_lsb)

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        for _, words, temperature in self.clock.samples_until(t):
            swapped = bytearray(12)
            swapped[0::2], swapped[1::2] = words[1::2], words[0::2]
            gyro, accel = bytes(swapped[:6]), bytes(swapped[6:])
            temperature_bytes = temperature.to_bytes(2, "big", signed=True)
            self._sample = accel + temperature_bytes + gyro
            self._interrupts |= _INT_DATA_READY
            enabled = self.values[FIFO_EN]
            if enabled and self.values[USER_CTRL] & _FIFO_ENABLE:
                self._store(enabled, accel, temperature_bytes, gyro)

    def _store(self, enabled: int, accel: bytes, temperature_bytes: bytes, gyro: bytes) -> None:
        """Append the enabled words of a sample to the FIFO; overwrite the oldest when it is full."""
        words = accel if enabled & _FIFO_EN_ACCEL else b""
        if enabled & _FIFO_EN_TEMPERATURE:
            words += temperature_bytes
        for axis, bit in enumerate(_FIFO_EN_GYRO):
            if enabled & bit:
                words += gyro[2 * axis : 2 * axis + 2]
        fifo = self._fifo
        fifo += words
        excess = len(fifo) - self.FIFO_BYTES
        if excess > 0:
            del fifo[:excess]
            self.fifo_dropped += (excess + 1) // 2
            self._interrupts |= _INT_FIFO_OVERFLOW

    def next_register(self, register: int) -> int:
        """Return the next register of a burst; FIFO_R_W repeats."""
        return register if register == FIFO_R_W else (register + 1) & 0x7F

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """Return a burst; sensor registers hold one sample for its duration."""
        if OUT <= self.pointer < OUT + 14 or self.pointer == INT_STATUS:
            self._measure_until(t)
            sample_bytes = self._sample
            data = bytearray()
            for _ in range(n):
                register = self.pointer
                data.append(
                    sample_bytes[register - OUT]
                    if OUT <= register < OUT + 14
                    else self.read_register(t, register)
                )
                self.pointer = self.next_register(register)
            return bytes(data)
        if self.pointer == FIFO_R_W:
            self._measure_until(t)
            data = self._fifo[:n]
            del self._fifo[:n]
            if len(data) < n:
                self.anomalies["read of empty FIFO"] += 1
            return bytes(data) + bytes(n - len(data))
        return super().read(t, n, byte_time)

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        self._measure_until(t)
        if register == INT_STATUS:
            status, self._interrupts = self._interrupts, 0
            return status
        if OUT <= register < OUT + 14:
            return self._sample[register - OUT]
        if register == FIFO_COUNT_H:
            self._count_latch = len(self._fifo)
            return self._count_latch >> 8
        if register == FIFO_COUNT_L:
            return self._count_latch & 0xFF
        if register == FIFO_R_W:
            return self._fifo.pop(0) if self._fifo else 0
        return self.values[register]


class Mpu6500(Mpu6050):
    """An MPU-6500 (RM-MPU-6500A): a FIFO of 512 bytes, another thermometer, one more low-pass."""

    chip_name = "mpu6500"
    IDENTITY = 0x70
    FIFO_BYTES = 512
    LSB_PER_DEGREE, DEGREES_AT_ZERO = 333.87, 21.0
    PWR_MGMT_1_RESET = 0x01
    EXTRA_REGISTERS = {
        ACCEL_CONFIG2: Register("ACCEL_CONFIG2", 0x00, 0x0F),
        0x1E: Register("LP_ACCEL_ODR", 0x00, 0x0F),
    }


class Mpu9250(Mpu6500):
    """An MPU-9250: an MPU-6500 with an AK8963 on an inner bus."""

    chip_name = "mpu9250"
    IDENTITY = 0x71

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x68) -> None:
        self.magnetometer = Ak8963(motion, specimen, self._connects_buses)
        self.companions = (self.magnetometer,)
        super().__init__(motion, specimen, address=address)

    def _connects_buses(self) -> bool:
        return bool(self.values[INT_PIN_CFG] & _BYPASS and not self.values[USER_CTRL] & _MASTER_ON)
