"""LSM6DS33 (LSM6DS3 register family): sampling, data-ready, temperature and the untagged 4096-word FIFO."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hubodo.arrays import Array
from hubodo.emulator.chips.imu import Imu, Specimen, dps_lsb, g_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import Raw, quantise
from hubodo.emulator.motion import Motion

WHO_AM_I, CTRL1_XL, CTRL2_G, CTRL3_C = 0x0F, 0x10, 0x11, 0x12
FIFO_CTRL1, FIFO_CTRL2, FIFO_CTRL3, FIFO_CTRL4, FIFO_CTRL5 = range(0x06, 0x0B)
STATUS, OUT_TEMP_L, OUT_G, OUT_XL = 0x1E, 0x20, 0x22, 0x28
FIFO_STATUS1, FIFO_DATA_L, FIFO_DATA_H, TIMESTAMP0 = 0x3A, 0x3E, 0x3F, 0x40

WAKE_UP_SRC, TAP_CFG, WAKE_UP_THS, WAKE_UP_DUR, MD1_CFG = 0x1B, 0x58, 0x5B, 0x5C, 0x5E
_LATCHED, _INT1_WU = 0x01, 0x20

FIFO_WORDS = 4096
ODR_HZ = (0.0, 12.5, 26.0, 52.0, 104.0, 208.0, 416.0, 833.0, 1660.0, 3330.0, 6660.0)
GYRO_DPS_PER_LSB = {0: 8.75e-3, 1: 17.5e-3, 2: 35e-3, 3: 70e-3}
GYRO_125_DPS_PER_LSB = 4.375e-3
ACCEL_G_PER_LSB = {0: 0.061e-3, 1: 0.488e-3, 2: 0.122e-3, 3: 0.244e-3}
FIFO_DECIMATION = (0, 1, 2, 3, 4, 8, 16, 32)
DEGREES_AT_ZERO, WORDS_PER_DEGREE = 25.0, 16.0

_READ_ONLY = {
    WHO_AM_I: "WHO_AM_I", 0x1B: "WAKE_UP_SRC", 0x1C: "TAP_SRC", 0x1D: "D6D_SRC", STATUS: "STATUS_REG",
    0x1F: "RESERVED",
    0x3A: "FIFO_STATUS1", 0x3B: "FIFO_STATUS2", 0x3C: "FIFO_STATUS3", 0x3D: "FIFO_STATUS4",
    0x3E: "FIFO_DATA_OUT_L", 0x3F: "FIFO_DATA_OUT_H",
    0x40: "TIMESTAMP0", 0x41: "TIMESTAMP1", 0x4B: "STEP_COUNTER_L", 0x4C: "STEP_COUNTER_H", 0x53: "FUNC_SRC",
    **{OUT_TEMP_L + i: f"OUT_{i:X}" for i in range(14)},
}  # fmt: skip
REGISTERS: dict[int, Register] = {
    0x01: Register("FUNC_CFG_ACCESS", 0x00, 0x80),
    FIFO_CTRL1: Register("FIFO_CTRL1", 0x00, 0xFF),
    FIFO_CTRL2: Register("FIFO_CTRL2", 0x00, 0xCF),
    FIFO_CTRL3: Register("FIFO_CTRL3", 0x00, 0x3F),
    FIFO_CTRL4: Register("FIFO_CTRL4", 0x00, 0x7F),
    FIFO_CTRL5: Register("FIFO_CTRL5", 0x00, 0x7F),
    0x0B: Register("ORIENT_CFG_G", 0x00, 0x3F),
    0x0D: Register("INT1_CTRL", 0x00, 0xFF),
    0x0E: Register("INT2_CTRL", 0x00, 0xFF),
    CTRL1_XL: Register("CTRL1_XL", 0x00, 0xFF),
    CTRL2_G: Register("CTRL2_G", 0x00, 0xFE),
    CTRL3_C: Register("CTRL3_C", 0x04, 0xFF),
    0x13: Register("CTRL4_C", 0x00, 0xFF),
    0x14: Register("CTRL5_C", 0x00, 0xFF),
    0x15: Register("CTRL6_C", 0x00, 0xF0),
    0x16: Register("CTRL7_G", 0x00, 0xFC),
    0x17: Register("CTRL8_XL", 0x00, 0xE5),
    0x18: Register("CTRL9_XL", 0x38, 0x3C),
    0x19: Register("CTRL10_C", 0x38, 0x3F),
    0x42: Register("TIMESTAMP2", 0x00, 0xFF),
    0x58: Register("TAP_CFG", 0x00, 0xFF),
    **{0x59 + i: Register(f"EVENT_CFG{i}", 0x00, 0xFF) for i in range(7)},
    **{address: Register(name) for address, name in _READ_ONLY.items()},
}
_RESET, _BOOT, _BDU, _IF_INC = 0x01, 0x80, 0x40, 0x04
_BYPASS, _FIFO, _CONTINUOUS = 0, 1, 6
_TIMESTAMP_TICK = 6.4e-3


class Lsm6ds33(Imu):
    """One LSM6DS33 on a wheel that moves as `motion` says.

    Register map, codes and FIFO layout: ST DocID026899 and AN4650. The wake-up event shows in WAKE_UP_SRC
    alone. Interrupt pins, other embedded functions, filters, self-test, axis enables and the third and fourth
    FIFO data set are not modelled; asking the
    FIFO for those sets is an oddity like any other, raised when strict.
    """

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x6B) -> None:
        specimen = specimen or Specimen()
        self._sample = bytes(12)
        self._temperature = 0
        self._ready = 0
        self._fifo = bytearray()
        self._fifo_word = 0
        self._over = False
        self._tick = 0
        self._holds = (1, 1)
        self._felt = 0
        super().__init__(motion, specimen, address, REGISTERS, (WHO_AM_I, specimen.who_am_i or 0x69))

    def temperature_word(self, degrees: Array) -> Raw:
        """16 LSB/degC, 0 at 25 degC."""
        return quantise((degrees - DEGREES_AT_ZERO) * WORDS_PER_DEGREE, 1.0)

    def power_on(self, t: float) -> None:
        """All registers as after power-up or SW_RESET: both sensors off, FIFO empty."""
        super().power_on(t)
        self.clock.stop()
        self._sample, self._temperature, self._ready = bytes(12), 0, 0
        self._timestamp_zero = t
        self._clear_fifo()

    def _clear_fifo(self) -> None:
        self._fifo.clear()
        self._fifo_word = 0
        self._over = False
        self._tick = 0
        self._pattern = self._pattern_of_fifo()

    def written(self, t: float, register: int) -> None:
        """Act on a control register that changed."""
        self._sync(t)
        if register == CTRL3_C:
            if self.values[CTRL3_C] & _RESET:
                self.power_on(t)
            self.values[CTRL3_C] &= ~_BOOT & 0xFF
        elif register in (CTRL1_XL, CTRL2_G):
            self._configure(t)
        elif FIFO_CTRL1 <= register <= FIFO_CTRL5:
            if register == FIFO_CTRL4 and self.values[FIFO_CTRL4] & 0x7F:
                self._odd("unmodelled FIFO set in", register)
            if register == FIFO_CTRL2 and self.values[FIFO_CTRL2] & 0xC0:
                self._odd("unmodelled FIFO timer in", register)
            if register in (FIFO_CTRL3, FIFO_CTRL5):
                self._clear_fifo()
        elif register == 0x42 and self.values[0x42] == 0xAA:
            self._timestamp_zero = t
            self.values[0x42] = 0

    def _configure(self, t: float) -> None:
        accel_code, gyro_code = self.values[CTRL1_XL] >> 4, self.values[CTRL2_G] >> 4
        if accel_code > 10 or gyro_code > 8:
            self._odd("reserved ODR code in", CTRL1_XL if accel_code > 10 else CTRL2_G)
            accel_code, gyro_code = (
                (0 if accel_code > 10 else accel_code),
                (0 if gyro_code > 8 else gyro_code),
            )
        master = max(accel_code, gyro_code)
        if master == 0:
            self.clock.stop()
            return
        self._holds = (
            1 << (master - gyro_code) if gyro_code else 0,
            1 << (master - accel_code) if accel_code else 0,
        )
        self._master, self._count = master, 0
        self.begin(t, ODR_HZ[master], self.gyro_lsb, self.accel_lsb, *self._holds)

    @property
    def gyro_lsb(self) -> float:
        """rad/s per LSB of the range in force."""
        code = self.values[CTRL2_G]
        return dps_lsb(GYRO_125_DPS_PER_LSB if code & 2 else GYRO_DPS_PER_LSB[code >> 2 & 3])

    @property
    def accel_lsb(self) -> float:
        """m/s^2 per LSB of the range in force."""
        return g_lsb(ACCEL_G_PER_LSB[self.values[CTRL1_XL] >> 2 & 3])

    def _pattern_of_fifo(self) -> Callable[[int], tuple[bool, bool]] | None:
        """Which sets FIFO tick k stores; None for the plain case of both in every tick."""
        xl, gy = (FIFO_DECIMATION[self.values[FIFO_CTRL3] >> shift & 7] for shift in (0, 3))
        self._pattern_words = self._words_of_pattern(gy, xl)
        if gy == xl == 1:
            return None
        return lambda k: (bool(gy) and k % gy == 0, bool(xl) and k % xl == 0)

    @staticmethod
    def _words_of_pattern(gy: int, xl: int) -> int:
        used = [d for d in (gy, xl) if d]
        if not used:
            return 1
        ticks = int(np.lcm.reduce(used))
        return sum(3 * (ticks // d) for d in used)

    def _sync(self, t: float) -> None:
        clock = self.clock
        while clock.time_of_next <= t:
            made = clock.step(t)
            if made is None:
                return
            before = self._sample
            _, self._sample, self._temperature = made
            if self.values[MD1_CFG] & _INT1_WU:
                self._feel(before)
            gyro_hold, accel_hold = self._holds
            k = self._count
            self._count = k + 1
            if accel_hold and k % accel_hold == 0:
                self._ready |= 0x05
            if gyro_hold and k % gyro_hold == 0:
                self._ready |= 0x06
            mode = self.values[FIFO_CTRL5] & 7
            if mode != _BYPASS:
                self._store(mode, k)

    def _feel(self, before: bytes) -> None:
        """Wake-up: half the step of each axis from sample to sample, beyond the threshold (AN4650, 5.4)."""
        slope = (
            np.abs(
                np.diff([np.frombuffer(b, "<i2")[3:].astype(int) for b in (before, self._sample)], axis=0)[0]
            )
            / 2
        )
        over = slope > (self.values[WAKE_UP_THS] & 0x3F) * 32768 / 64
        if not any(before):
            return
        self._felt = self._felt + 1 if over.any() else 0
        if self._felt > (self.values[WAKE_UP_DUR] >> 5 & 3):
            self.values[WAKE_UP_SRC] |= 0x08 | int(over[0]) << 2 | int(over[1]) << 1 | int(over[2])
        elif not self.values[TAP_CFG] & _LATCHED:
            self.values[WAKE_UP_SRC] = 0

    def _store(self, mode: int, k: int) -> None:
        code = self.values[FIFO_CTRL5] >> 3 & 0xF
        if code == 0 or code > 10:
            return
        if code < self._master and k % (1 << (self._master - code)):
            return
        if self._pattern is None:
            words = self._sample
        else:
            gyro, accel = self._pattern(self._tick)
            words = (self._sample[:6] if gyro else b"") + (self._sample[6:] if accel else b"")
        self._tick += 1
        fifo = self._fifo
        if mode == _FIFO and len(fifo) + len(words) > 2 * FIFO_WORDS:
            self._over = True
            self.fifo_dropped += len(words) // 2
            return
        fifo += words
        excess = len(fifo) - 2 * FIFO_WORDS
        if excess > 0:
            del fifo[:excess]
            self._fifo_word += excess // 2
            self.fifo_dropped += excess // 2
            self._over = True

    def after(self, register: int) -> int:
        """IF_INC, with the automatic rounding of FIFO_DATA_OUT."""
        if not self.values[CTRL3_C] & _IF_INC:
            return register
        return FIFO_DATA_L if register == FIFO_DATA_H else (register + 1) & 0x7F

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """A burst; whole words of the FIFO and of untorn output registers at once."""
        start = self.pointer
        if start == FIFO_DATA_L and n % 2 == 0 and self.values[CTRL3_C] & _IF_INC:
            self._sync(t)
            return self._pop(n, t, byte_time)
        if start >= STATUS and start + n <= OUT_XL + 6 and self.values[CTRL3_C] & _IF_INC:
            self._sync(t)
            if self.clock.time_of_next > t + n * byte_time:
                block = (
                    bytes((self._ready, 0))
                    + self._temperature.to_bytes(2, "little", signed=True)
                    + self._sample
                )
                for register in range(start, start + n):
                    self._taken(register)
                self.pointer = start + n
                return block[start - STATUS : start - STATUS + n]
        return super().read(t, n, byte_time)

    def _pop(self, n: int, t: float, byte_time: float) -> bytes:
        if len(self._fifo) < n:
            self._sync(t + n * byte_time)
        out = bytes(self._fifo[:n])
        del self._fifo[:n]
        self._fifo_word += len(out) // 2
        if out:
            self._over = False
        if len(out) < n:
            self.oddities["read of empty FIFO"] += 1
        return out + bytes(n - len(out))

    def _taken(self, register: int) -> None:
        if register in (OUT_TEMP_L + 1, OUT_G + 1, OUT_G + 3, OUT_G + 5, OUT_XL + 1, OUT_XL + 3, OUT_XL + 5):
            self._ready &= ~(0x04 if register < OUT_G else 0x02 if register < OUT_XL else 0x01)

    def fetch(self, t: float, register: int) -> int:
        """One byte, with the side effects of reading it."""
        low_of_held_word = bool(self.values[CTRL3_C] & _BDU) and register % 2 == 1 and 0x20 <= register < 0x2E
        if not low_of_held_word:
            self._sync(t)
        if register == STATUS:
            return self._ready
        if OUT_TEMP_L <= register < OUT_XL + 6:
            self._taken(register)
            block = self._temperature.to_bytes(2, "little", signed=True) + self._sample
            return block[register - OUT_TEMP_L]
        if FIFO_STATUS1 <= register <= FIFO_STATUS1 + 3:
            return self._fifo_status(register - FIFO_STATUS1)
        if register == WAKE_UP_SRC:
            felt = self.values[WAKE_UP_SRC]
            if self.values[TAP_CFG] & _LATCHED:
                self.values[WAKE_UP_SRC] = 0
            return felt
        if register == FIFO_DATA_L:
            return self._fifo[0] if self._fifo else 0
        if register == FIFO_DATA_H:
            return self._pop(2, t, 0.0)[1]
        if TIMESTAMP0 <= register < TIMESTAMP0 + 3:
            return self._timestamp(t) >> 8 * (register - TIMESTAMP0) & 0xFF
        return self.values[register]

    def _timestamp(self, t: float) -> int:
        if not self.values[0x58] & 0x80:
            return 0
        return int((t - self._timestamp_zero) / _TIMESTAMP_TICK) & 0xFFFFFF

    def _fifo_status(self, index: int) -> int:
        words = len(self._fifo) // 2
        if index == 0:
            return words & 0xFF
        if index == 1:
            watermark = self.values[FIFO_CTRL1] | (self.values[FIFO_CTRL2] & 0x0F) << 8
            full = words + 6 > FIFO_WORDS
            return (
                (words >> 8 & 0x0F)
                | (0x80 if watermark and words >= watermark else 0)
                | (0x40 if self._over else 0)
                | (0x20 if full else 0)
                | (0x10 if words == 0 else 0)
            )
        pattern = self._fifo_word % self._pattern_words
        return pattern & 0xFF if index == 2 else pattern >> 8 & 0x03
