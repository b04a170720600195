"""Emulated LSM6DS33 (LSM6DS3 register family): sampling, data-ready, temperature and untagged FIFO."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hubodo.arrays import Array
from hubodo.emulator.chips.imu import Imu, Specimen, accel_per_lsb, rad_per_lsb
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import RawWords, quantise
from hubodo.emulator.motion import Motion

WHO_AM_I, CTRL1_XL, CTRL2_G, CTRL3_C = 0x0F, 0x10, 0x11, 0x12
FIFO_CTRL1, FIFO_CTRL2, FIFO_CTRL3, FIFO_CTRL4, FIFO_CTRL5 = range(0x06, 0x0B)
STATUS, OUT_TEMP_L, OUT_G, OUT_XL = 0x1E, 0x20, 0x22, 0x28
FIFO_STATUS1, FIFO_DATA_L, FIFO_DATA_H, TIMESTAMP0 = 0x3A, 0x3E, 0x3F, 0x40

WAKE_UP_SRC, TAP_CFG, WAKE_UP_THS, WAKE_UP_DUR, MD1_CFG = 0x1B, 0x58, 0x5B, 0x5C, 0x5E
_LIR, _INT1_WU = 0x01, 0x20

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
_SW_RESET, _BOOT, _BDU, _IF_INC = 0x01, 0x80, 0x40, 0x04
_BYPASS_MODE, _FIFO_MODE, _CONTINUOUS = 0, 1, 6
_TIMESTAMP_TICK_S = 6.4e-3


class Lsm6ds33(Imu):
    """An LSM6DS33 that is moved by `motion`.

    Register map, codes and FIFO layout: ST DocID026899 and AN4650. The wake-up event appears in WAKE_UP_SRC
    and on INT1. Not modelled: other interrupts and embedded functions, filters, self-test, axis enables, and
    the third and fourth FIFO data set; enabling those sets counts as an anomaly, and raises ChipAccessError
    when strict.
    """

    chip_name = "lsm6ds33"
    IDENTITY = 0x69
    REGISTERS = REGISTERS
    ODR_HZ = ODR_HZ
    FIFO_OUTPUT = (FIFO_DATA_L, FIFO_DATA_H)
    WAKE_SOURCE = WAKE_UP_SRC
    SAMPLING: tuple[int, ...] = (CTRL1_XL, CTRL2_G)
    """Registers that restart the sampling."""

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x6B) -> None:
        specimen = specimen or Specimen()
        self._sample = bytes(12)
        self._temperature = 0
        self._data_ready = 0
        self._fifo = bytearray()
        self._fifo_word = 0
        self._overrun = False
        self._fifo_tick = 0
        self._hold_ticks = (1, 1)
        self._wake_up_count = 0
        super().__init__(
            motion, specimen, address, self.REGISTERS, (WHO_AM_I, specimen.who_am_i or self.IDENTITY)
        )

    def temperature_word(self, degrees: Array) -> RawWords:
        """Return temperature words, 16 LSB/°C and 0 at 25 °C."""
        return quantise((degrees - DEGREES_AT_ZERO) * WORDS_PER_DEGREE, 1.0)

    def power_on(self, t: float) -> None:
        """Reset the registers at t, as power-up and SW_RESET do: both sensors off, FIFO empty."""
        super().power_on(t)
        self.clock.stop()
        self._sample, self._temperature, self._data_ready = bytes(12), 0, 0
        self._timestamp_zero = t
        self._clear_fifo()

    def _clear_fifo(self) -> None:
        """Empty the FIFO and restart its pattern."""
        self._fifo.clear()
        self._fifo_word = 0
        self._overrun = False
        self._fifo_tick = 0
        self._pattern = self._pattern_of_fifo()

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == CTRL3_C:
            if self.values[CTRL3_C] & _SW_RESET:
                self.power_on(t)
            self.values[CTRL3_C] &= ~_BOOT & 0xFF
        elif register in self.SAMPLING:
            self._configure(t)
        else:
            self._on_fifo_or_clock(t, register)

    def _on_fifo_or_clock(self, t: float, register: int) -> None:
        """React to a register of the FIFO or of the time stamps that changed."""
        if FIFO_CTRL1 <= register <= FIFO_CTRL5:
            if register == FIFO_CTRL4 and self.values[FIFO_CTRL4] & 0x7F:
                self._count_anomaly("unmodelled FIFO set in", register)
            if register == FIFO_CTRL2 and self.values[FIFO_CTRL2] & 0xC0:
                self._count_anomaly("unmodelled FIFO timer in", register)
            if register in (FIFO_CTRL3, FIFO_CTRL5):
                self._clear_fifo()
        elif register == 0x42 and self.values[0x42] == 0xAA:
            self._timestamp_zero = t
            self.values[0x42] = 0

    def _rate_codes(self) -> tuple[int, int]:
        """Return the codes of the output data rates of accelerometer and gyro, 0 when off or reserved."""
        accel_code, gyro_code = self.values[CTRL1_XL] >> 4, self.values[CTRL2_G] >> 4
        if accel_code > 10 or gyro_code > 8:
            self._count_anomaly("reserved ODR code in", CTRL1_XL if accel_code > 10 else CTRL2_G)
            accel_code, gyro_code = (
                (0 if accel_code > 10 else accel_code),
                (0 if gyro_code > 8 else gyro_code),
            )
        return accel_code, gyro_code

    def _configure(self, t: float) -> None:
        """Restart sampling with the current output data rates, or stop it when both sensors are off."""
        accel_code, gyro_code = self._rate_codes()
        clock_code = max(accel_code, gyro_code)
        if clock_code == 0:
            self.clock.stop()
            return
        self._hold_ticks = (
            1 << (clock_code - gyro_code) if gyro_code else 0,
            1 << (clock_code - accel_code) if accel_code else 0,
        )
        self._clock_code, self._sample_count = clock_code, 0
        self.start_sampling(t, self.ODR_HZ[clock_code], self.gyro_lsb, self.accel_lsb, *self._hold_ticks)

    @property
    def gyro_lsb(self) -> float:
        """Resolution of the gyro at the current range, rad/s per LSB."""
        code = self.values[CTRL2_G]
        return rad_per_lsb(GYRO_125_DPS_PER_LSB if code & 2 else GYRO_DPS_PER_LSB[code >> 2 & 3])

    @property
    def accel_lsb(self) -> float:
        """Resolution of the accelerometer at the current range, m/s² per LSB."""
        return accel_per_lsb(ACCEL_G_PER_LSB[self.values[CTRL1_XL] >> 2 & 3])

    def _pattern_of_fifo(self) -> Callable[[int], tuple[bool, bool]] | None:
        """Return a function of the FIFO tick that tells which data sets are stored; None if always both."""
        accel_decimation, gyro_decimation = (
            FIFO_DECIMATION[self.values[FIFO_CTRL3] >> shift & 7] for shift in (0, 3)
        )
        self._pattern_words = self._words_of_pattern(gyro_decimation, accel_decimation)
        if gyro_decimation == accel_decimation == 1:
            return None
        return lambda tick: (
            bool(gyro_decimation) and tick % gyro_decimation == 0,
            bool(accel_decimation) and tick % accel_decimation == 0,
        )

    @staticmethod
    def _words_of_pattern(gyro_decimation: int, accel_decimation: int) -> int:
        """Return the number of words in one period of the FIFO pattern."""
        decimations = [d for d in (gyro_decimation, accel_decimation) if d]
        if not decimations:
            return 1
        ticks = int(np.lcm.reduce(decimations))
        return sum(3 * (ticks // d) for d in decimations)

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        clock = self.clock
        for sample in clock.samples_until(t):
            previous = self._sample
            _, self._sample, self._temperature = sample
            if self.values[MD1_CFG] & _INT1_WU:
                self._detect_wake_up(previous)
            gyro_hold, accel_hold = self._hold_ticks
            tick = self._sample_count
            self._sample_count = tick + 1
            if accel_hold and tick % accel_hold == 0:
                self._data_ready |= 0x05
            if gyro_hold and tick % gyro_hold == 0:
                self._data_ready |= 0x06
            mode = self.values[FIFO_CTRL5] & 7
            if mode != _BYPASS_MODE:
                self._store(mode, tick)

    def _is_latched(self) -> bool:
        """Return True if the wake-up event persists until it is read."""
        return bool(self.values[TAP_CFG] & _LIR)

    def _wake_up_threshold(self) -> float:
        """Return the threshold of the wake-up detection in output words."""
        return (self.values[WAKE_UP_THS] & 0x3F) * 32768 / 64

    def _detect_wake_up(self, previous: bytes) -> None:
        """Detect a wake-up event: half the step of an axis exceeds the threshold (AN4650, 5.4)."""
        slope = (
            np.abs(
                np.diff([np.frombuffer(b, "<i2")[3:].astype(int) for b in (previous, self._sample)], axis=0)[
                    0
                ]
            )
            / 2
        )
        exceeded = slope > self._wake_up_threshold()
        if not any(previous):
            return
        self._wake_up_count = self._wake_up_count + 1 if exceeded.any() else 0
        if self._wake_up_count > (self.values[WAKE_UP_DUR] >> 5 & 3):
            self.values[self.WAKE_SOURCE] |= (
                0x08 | int(exceeded[0]) << 2 | int(exceeded[1]) << 1 | int(exceeded[2])
            )
        elif not self._is_latched():
            self.values[self.WAKE_SOURCE] = 0

    def interrupt_level(self, t: float) -> int:
        """Return 1 while a wake-up event that is routed to INT1 persists."""
        self._measure_until(t)
        return int(bool(self.values[MD1_CFG] & _INT1_WU and self.values[self.WAKE_SOURCE] & 0x08))

    def _store(self, mode: int, tick: int) -> None:
        """Append a sample to the FIFO, with decimation; when it is full, drop the oldest or newest words."""
        code = self.values[FIFO_CTRL5] >> 3 & 0xF
        if code == 0 or code > 10:
            return
        if code < self._clock_code and tick % (1 << (self._clock_code - code)):
            return
        if self._pattern is None:
            words = self._sample
        else:
            gyro, accel = self._pattern(self._fifo_tick)
            words = (self._sample[:6] if gyro else b"") + (self._sample[6:] if accel else b"")
        self._fifo_tick += 1
        fifo = self._fifo
        if mode == _FIFO_MODE and len(fifo) + len(words) > 2 * FIFO_WORDS:
            self._overrun = True
            self.fifo_dropped += len(words) // 2
            return
        fifo += words
        excess = len(fifo) - 2 * FIFO_WORDS
        if excess > 0:
            del fifo[:excess]
            self._fifo_word += excess // 2
            self.fifo_dropped += excess // 2
            self._overrun = True

    def next_register(self, register: int) -> int:
        """Return the next register of a burst, by IF_INC, with the roll-over of the FIFO's output."""
        if not self.increments_address:
            return register
        first, last = self.FIFO_OUTPUT
        return first if register == last else (register + 1) & 0x7F

    @property
    def increments_address(self) -> bool:
        """Return True if a burst reads successive registers."""
        return bool(self.values[CTRL3_C] & _IF_INC)

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """Return a burst; whole words of the FIFO and consistent output registers are read at once."""
        start = self.pointer
        if start == FIFO_DATA_L and n % 2 == 0 and self.increments_address:
            self._measure_until(t)
            return self._pop_fifo(n, t, byte_time)
        if start >= STATUS and start + n <= OUT_XL + 6 and self.increments_address:
            self._measure_until(t)
            if self.clock.next_sample_time > t + n * byte_time:
                block = (
                    bytes((self._data_ready, 0))
                    + self._temperature.to_bytes(2, "little", signed=True)
                    + self._sample
                )
                for register in range(start, start + n):
                    self._clear_data_ready(register)
                self.pointer = start + n
                return block[start - STATUS : start - STATUS + n]
        return super().read(t, n, byte_time)

    def _pop_fifo(self, n: int, t: float, byte_time: float) -> bytes:
        """Remove n bytes from the FIFO and return them, with zeros beyond its end."""
        if len(self._fifo) < n:
            self._measure_until(t + n * byte_time)
        data = bytes(self._fifo[:n])
        del self._fifo[:n]
        self._fifo_word += len(data) // 2
        if data:
            self._overrun = False
        if len(data) < n:
            self.anomalies["read of empty FIFO"] += 1
        return data + bytes(n - len(data))

    def _clear_data_ready(self, register: int) -> None:
        """Clear the data-ready flag of the sensor whose high byte was read."""
        if register in (OUT_TEMP_L + 1, OUT_G + 1, OUT_G + 3, OUT_G + 5, OUT_XL + 1, OUT_XL + 3, OUT_XL + 5):
            self._data_ready &= ~(0x04 if register < OUT_G else 0x02 if register < OUT_XL else 0x01)

    def _measure_before_read(self, t: float, register: int) -> None:
        """Measure the samples due by t, unless BDU holds this high byte until it is read."""
        if not (self.values[CTRL3_C] & _BDU and register % 2 == 1 and 0x20 <= register < 0x2E):
            self._measure_until(t)

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        self._measure_before_read(t, register)
        if register == STATUS:
            return self._data_ready
        if OUT_TEMP_L <= register < OUT_XL + 6:
            self._clear_data_ready(register)
            block = self._temperature.to_bytes(2, "little", signed=True) + self._sample
            return block[register - OUT_TEMP_L]
        if FIFO_STATUS1 <= register <= FIFO_STATUS1 + 3:
            return self._fifo_status(register - FIFO_STATUS1)
        if register == self.WAKE_SOURCE:
            source = self.values[self.WAKE_SOURCE]
            if self._is_latched():
                self.values[self.WAKE_SOURCE] = 0
            return source
        if register == FIFO_DATA_L:
            return self._fifo[0] if self._fifo else 0
        if register == FIFO_DATA_H:
            return self._pop_fifo(2, t, 0.0)[1]
        if TIMESTAMP0 <= register < TIMESTAMP0 + 3:
            return self._timestamp(t) >> 8 * (register - TIMESTAMP0) & 0xFF
        return self.values[register]

    def _timestamp(self, t: float) -> int:
        """Return the timestamp counter at t."""
        if not self.values[0x58] & 0x80:
            return 0
        return int((t - self._timestamp_zero) / _TIMESTAMP_TICK_S) & 0xFFFFFF

    def _fifo_status(self, index: int) -> int:
        """Return the byte of FIFO_STATUS1 + index."""
        words = len(self._fifo) // 2
        if index == 0:
            return words & 0xFF
        if index == 1:
            watermark = self.values[FIFO_CTRL1] | (self.values[FIFO_CTRL2] & 0x0F) << 8
            full = words + 6 > FIFO_WORDS
            return (
                (words >> 8 & 0x0F)
                | (0x80 if watermark and words >= watermark else 0)
                | (0x40 if self._overrun else 0)
                | (0x20 if full else 0)
                | (0x10 if words == 0 else 0)
            )
        pattern = self._fifo_word % self._pattern_words
        return pattern & 0xFF if index == 2 else pattern >> 8 & 0x03
