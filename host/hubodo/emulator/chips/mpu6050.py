"""MPU-6050 and its 6500 relatives: asleep at reset, big-endian, 1024-byte FIFO with a latched count."""

from __future__ import annotations

from hubodo.arrays import Array
from hubodo.emulator.chips.imu import Imu, Specimen, dps_lsb, g_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import Raw, quantise
from hubodo.emulator.motion import Motion

SMPLRT_DIV, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, ACCEL_CONFIG2 = 0x19, 0x1A, 0x1B, 0x1C, 0x1D
FIFO_EN, INT_PIN_CFG, INT_ENABLE, INT_STATUS = 0x23, 0x37, 0x38, 0x3A
OUT, USER_CTRL, PWR_MGMT_1, PWR_MGMT_2 = 0x3B, 0x6A, 0x6B, 0x6C
FIFO_COUNT_H, FIFO_COUNT_L, FIFO_R_W, WHO_AM_I = 0x72, 0x73, 0x74, 0x75

FIFO_BYTES = 1024
GYRO_LSB_PER_DPS = (131.0, 65.5, 32.8, 16.4)
ACCEL_LSB_PER_G = (16384.0, 8192.0, 4096.0, 2048.0)
_DEVICE_RESET, _SLEEP = 0x80, 0x40
_FIFO_ENABLE, _FIFO_RESET = 0x40, 0x04
_DATA_READY, _OVERFLOW = 0x01, 0x10
_ACCEL, _TEMPERATURE, _GYRO = 0x08, 0x80, (0x40, 0x20, 0x10)

_COMMON: dict[int, Register] = {
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
    """One MPU-6050 on a wheel that moves as `motion` says.

    Register map and formulas: InvenSense RM-MPU-6000A and PS-MPU-6000A. The auxiliary bus, self-test,
    motion detection and the DLPF's frequency response are not modelled (its code sets the gyro's base rate).
    """

    IDENTITY = 0x68
    PER_DEGREE, AT_ZERO = 340.0, 36.53
    EXTRA: dict[int, Register] = {}

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x68) -> None:
        specimen = specimen or Specimen()
        self._sample = bytes(14)
        self._interrupts = 0
        self._fifo = bytearray()
        self._count_latch = 0
        super().__init__(
            motion, specimen, address, _COMMON | self.EXTRA, (WHO_AM_I, specimen.who_am_i or self.IDENTITY)
        )

    def temperature_word(self, degrees: Array) -> Raw:
        """raw = (T - AT_ZERO) * PER_DEGREE."""
        return quantise((degrees - self.AT_ZERO) * self.PER_DEGREE, 1.0)

    def power_on(self, t: float) -> None:
        """Registers as after power-up or DEVICE_RESET."""
        super().power_on(t)
        self.values[PWR_MGMT_1] = self.RESET_POWER
        self.clock.stop()
        self._sample, self._interrupts = bytes(14), 0
        self._fifo.clear()
        self._count_latch = 0
        if not self.values[PWR_MGMT_1] & _SLEEP:
            self._configure(t)

    RESET_POWER = 0x40

    @property
    def gyro_lsb(self) -> float:
        """rad/s per LSB of the range in force."""
        return dps_lsb(1.0 / GYRO_LSB_PER_DPS[self.values[GYRO_CONFIG] >> 3 & 3])

    @property
    def accel_lsb(self) -> float:
        """m/s^2 per LSB of the range in force."""
        return g_lsb(1.0 / ACCEL_LSB_PER_G[self.values[ACCEL_CONFIG] >> 3 & 3])

    @property
    def sample_hz(self) -> float:
        """Nominal: 8 kHz (DLPF 0 or 7) or 1 kHz over 1 + SMPLRT_DIV."""
        base = 8000.0 if self.values[CONFIG] & 7 in (0, 7) else 1000.0
        return base / (1 + self.values[SMPLRT_DIV])

    def written(self, t: float, register: int) -> None:
        """Act on a control register that changed."""
        self._sync(t)
        if register == PWR_MGMT_1 and self.values[PWR_MGMT_1] & _DEVICE_RESET:
            self.power_on(t)
        elif register in (SMPLRT_DIV, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, PWR_MGMT_1):
            self._configure(t)
        elif register == USER_CTRL and self.values[USER_CTRL] & _FIFO_RESET:
            self.values[USER_CTRL] &= ~_FIFO_RESET & 0xFF
            self._fifo.clear()
        elif register == FIFO_EN and self.values[FIFO_EN] & 0x07:
            self._odd("unmodelled FIFO set in", register)

    def _configure(self, t: float) -> None:
        if self.values[PWR_MGMT_1] & _SLEEP:
            self.clock.stop()
        else:
            self.begin(t, self.sample_hz, self.gyro_lsb, self.accel_lsb)

    def _sync(self, t: float) -> None:
        while self.clock.time_of_next <= t:
            made = self.clock.step(t)
            if made is None:
                return
            _, words, temperature = made
            swapped = bytearray(12)
            swapped[0::2], swapped[1::2] = words[1::2], words[0::2]
            gyro, accel = bytes(swapped[:6]), bytes(swapped[6:])
            warm = temperature.to_bytes(2, "big", signed=True)
            self._sample = accel + warm + gyro
            self._interrupts |= _DATA_READY
            enabled = self.values[FIFO_EN]
            if enabled and self.values[USER_CTRL] & _FIFO_ENABLE:
                self._store(enabled, accel, warm, gyro)

    def _store(self, enabled: int, accel: bytes, warm: bytes, gyro: bytes) -> None:
        words = accel if enabled & _ACCEL else b""
        if enabled & _TEMPERATURE:
            words += warm
        for axis, bit in enumerate(_GYRO):
            if enabled & bit:
                words += gyro[2 * axis : 2 * axis + 2]
        fifo = self._fifo
        fifo += words
        excess = len(fifo) - FIFO_BYTES
        if excess > 0:
            del fifo[:excess]
            self.fifo_dropped += (excess + 1) // 2
            self._interrupts |= _OVERFLOW

    def after(self, register: int) -> int:
        """Bursts go on, but stay on FIFO_R_W."""
        return register if register == FIFO_R_W else (register + 1) & 0x7F

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """A burst; sensor registers hold one sample from its start to its end."""
        if OUT <= self.pointer < OUT + 14 or self.pointer == INT_STATUS:
            self._sync(t)
            held = self._sample
            out = bytearray()
            for _ in range(n):
                register = self.pointer
                out.append(held[register - OUT] if OUT <= register < OUT + 14 else self.fetch(t, register))
                self.pointer = self.after(register)
            return bytes(out)
        if self.pointer == FIFO_R_W:
            self._sync(t)
            out = self._fifo[:n]
            del self._fifo[:n]
            if len(out) < n:
                self.oddities["read of empty FIFO"] += 1
            return bytes(out) + bytes(n - len(out))
        return super().read(t, n, byte_time)

    def fetch(self, t: float, register: int) -> int:
        """One byte, with the side effects of reading it."""
        self._sync(t)
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
    """One MPU-6500 (0x70; 0x71 and 0x73 are 9250 and 9255, 0x98 is seen in the wild): other thermometer."""

    IDENTITY = 0x70
    PER_DEGREE, AT_ZERO = 333.87, 21.0
    RESET_POWER = 0x01
    EXTRA = {ACCEL_CONFIG2: Register("ACCEL_CONFIG2", 0x00, 0x0F), 0x1E: Register("LP_ACCEL_ODR", 0x00, 0x0F)}
