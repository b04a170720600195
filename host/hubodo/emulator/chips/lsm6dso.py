"""Emulated LSM6DSO and LSM6DSR: the sampling of an LSM6DS33, and a FIFO of tagged words with time stamps."""

from __future__ import annotations

from hubodo.arrays import Array
from hubodo.emulator.chips.imu import Specimen, rad_per_lsb
from hubodo.emulator.chips.lsm6ds33 import (
    CTRL1_XL,
    CTRL2_G,
    CTRL3_C,
    MD1_CFG,
    OUT_TEMP_L,
    STATUS,
    TAP_CFG,
    WAKE_UP_DUR,
    WAKE_UP_SRC,
    WAKE_UP_THS,
    WHO_AM_I,
    Lsm6ds33,
)
from hubodo.emulator.chips.registers import Register
from hubodo.emulator.chips.sampling import RawWords, quantise
from hubodo.emulator.motion import Motion

FIFO_CTRL1, FIFO_CTRL2, FIFO_CTRL3, FIFO_CTRL4 = range(0x07, 0x0B)
CTRL10_C, FIFO_STATUS1, TIMESTAMP0, TAP_CFG0, TAP_CFG2 = 0x19, 0x3A, 0x40, 0x56, TAP_CFG
INTERNAL_FREQ_FINE, FIFO_TAG, FIFO_LAST = 0x63, 0x78, 0x7E

WORD_BYTES = 7
TAG_GYRO, TAG_ACCEL, TAG_TIMESTAMP = 0x01, 0x02, 0x04
GYRO_4000_DPS_PER_LSB = 0.14
_LIR, _INT1_WU = 0x01, 0x20
_BYPASS_MODE, _FIFO_MODE = 0, 1

_READ_ONLY_REGISTERS = {
    WHO_AM_I: "WHO_AM_I", 0x1A: "ALL_INT_SRC", WAKE_UP_SRC: "WAKE_UP_SRC", 0x1C: "TAP_SRC", 0x1D: "D6D_SRC",
    STATUS: "STATUS_REG", 0x1F: "RESERVED", 0x3A: "FIFO_STATUS1", 0x3B: "FIFO_STATUS2",
    INTERNAL_FREQ_FINE: "INTERNAL_FREQ_FINE",
    **{OUT_TEMP_L + i: f"OUT_{i:X}" for i in range(14)},
    **{TIMESTAMP0 + i: f"TIMESTAMP{i}" for i in range(4)},
    **{FIFO_TAG + i: f"FIFO_DATA_OUT_{i}" for i in range(WORD_BYTES)},
}  # fmt: skip
REGISTERS: dict[int, Register] = {
    0x01: Register("FUNC_CFG_ACCESS", 0x00, 0xC0),
    0x02: Register("PIN_CTRL", 0x3F, 0x40),
    FIFO_CTRL1: Register("FIFO_CTRL1", 0x00, 0xFF),
    FIFO_CTRL2: Register("FIFO_CTRL2", 0x00, 0xD7),
    FIFO_CTRL3: Register("FIFO_CTRL3", 0x00, 0xFF),
    FIFO_CTRL4: Register("FIFO_CTRL4", 0x00, 0xF7),
    0x0B: Register("COUNTER_BDR_REG1", 0x00, 0xE7),
    0x0C: Register("COUNTER_BDR_REG2", 0x00, 0xFF),
    0x0D: Register("INT1_CTRL", 0x00, 0xFF),
    0x0E: Register("INT2_CTRL", 0x00, 0xFF),
    CTRL1_XL: Register("CTRL1_XL", 0x00, 0xFE),
    CTRL2_G: Register("CTRL2_G", 0x00, 0xFE),
    CTRL3_C: Register("CTRL3_C", 0x04, 0xFD),
    0x13: Register("CTRL4_C", 0x00, 0x7E),
    0x14: Register("CTRL5_C", 0x00, 0xEF),
    0x15: Register("CTRL6_C", 0x00, 0xFF),
    0x16: Register("CTRL7_G", 0x00, 0xF7),
    0x17: Register("CTRL8_XL", 0x00, 0xFF),
    0x18: Register("CTRL9_XL", 0xE0, 0xFE),
    CTRL10_C: Register("CTRL10_C", 0x00, 0x20),
    TAP_CFG0: Register("TAP_CFG0", 0x00, 0x7F),
    0x57: Register("TAP_CFG1", 0x00, 0xFF),
    TAP_CFG2: Register("TAP_CFG2", 0x00, 0xFF),
    0x59: Register("TAP_THS_6D", 0x00, 0xFF),
    0x5A: Register("INT_DUR2", 0x00, 0xFF),
    WAKE_UP_THS: Register("WAKE_UP_THS", 0x00, 0xFF),
    WAKE_UP_DUR: Register("WAKE_UP_DUR", 0x00, 0xFF),
    0x5D: Register("FREE_FALL", 0x00, 0xFF),
    MD1_CFG: Register("MD1_CFG", 0x00, 0xFF),
    0x5F: Register("MD2_CFG", 0x00, 0xFF),
    **{address: Register(name) for address, name in _READ_ONLY_REGISTERS.items()},
}


class Lsm6dso(Lsm6ds33):
    """An LSM6DSO that is moved by `motion`.

    Register map, codes and FIFO: ST DS12140 and AN5192. Not modelled: compression, batch rates that differ
    from each other or from the sample rate, embedded functions, interrupts but the wake-up on INT1; batch
    rates that differ count as an anomaly. Assumed: the words of one sample are gyro, accelerometer, time
    stamp, in this order.
    """

    chip_name = "lsm6dso"
    IDENTITY = 0x6C
    REGISTERS = REGISTERS
    FIFO_OUTPUT = (FIFO_TAG, FIFO_LAST)
    ODR_HZ = (0.0, *(6667.0 / 2**n for n in range(9, -1, -1)))
    FIFO_STATUS, FIFO_WORDS = FIFO_STATUS1, 512
    TICKS_PER_SECOND = 40e3
    RATE_CALIBRATION, FINE_STEP = INTERNAL_FREQ_FINE, 0.0015
    TIMESTAMP_ENABLE, INTERRUPTS_ENABLE = (CTRL10_C, 0x20), (TAP_CFG2, 0x80)
    """(register, bit)."""
    HAS_PARITY = True
    """True if the lowest bit of a tag makes its parity even."""

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x6B) -> None:
        self._tag_count = -1
        super().__init__(motion, specimen, address=address)

    def temperature_word(self, degrees: Array) -> RawWords:
        """Return temperature words, 256 LSB/°C and 0 at 25 °C."""
        return quantise((degrees - 25.0) * 256.0, 1.0)

    def power_on(self, t: float) -> None:
        """Reset the registers at t; the factory's measurement of the rate persists."""
        super().power_on(t)
        fine = round(self.specimen.odr_error / self.FINE_STEP)
        self.values[self.RATE_CALIBRATION] = max(-128, min(fine, 127)) & 0xFF

    @property
    def gyro_lsb(self) -> float:
        """Resolution of the gyro at the current range, rad/s per LSB."""
        return rad_per_lsb(GYRO_4000_DPS_PER_LSB) if self.values[CTRL2_G] & 1 else super().gyro_lsb

    def _is_set(self, flag: tuple[int, int]) -> bool:
        """Return True if a (register, bit) is set."""
        return bool(self.values[flag[0]] & flag[1])

    def _clear_fifo(self) -> None:
        """Empty the FIFO."""
        self._fifo.clear()
        self._overrun = False

    def _on_fifo_or_clock(self, t: float, register: int) -> None:
        """React to a register of the FIFO or of the time stamps that changed."""
        if register == FIFO_CTRL3:
            gyro, accel = self.values[FIFO_CTRL3] >> 4, self.values[FIFO_CTRL3] & 0x0F
            if gyro != accel:
                self._count_anomaly("unmodelled batch rates in", register)
        elif register == FIFO_CTRL4:
            if self.values[FIFO_CTRL4] & 7 == _BYPASS_MODE:
                self._clear_fifo()
        elif register == self.TIMESTAMP_ENABLE[0] and not self._is_set(self.TIMESTAMP_ENABLE):
            self._timestamp_zero = t

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        clock = self.clock
        for sample in clock.samples_until(t):
            previous = self._sample
            when, self._sample, self._temperature = sample
            if self.values[MD1_CFG] & _INT1_WU and self._is_set(self.INTERRUPTS_ENABLE):
                self._detect_wake_up(previous)
            gyro_hold, accel_hold = self._hold_ticks
            tick = self._sample_count
            self._sample_count = tick + 1
            if accel_hold and tick % accel_hold == 0:
                self._data_ready |= 0x05
            if gyro_hold and tick % gyro_hold == 0:
                self._data_ready |= 0x06
            self._store_sample(when)

    def _is_latched(self) -> bool:
        """Return True if the wake-up event persists until it is read."""
        return bool(self.values[TAP_CFG0] & _LIR)

    def _timestamp(self, t: float) -> int:
        """Return the timestamp counter at t, in ticks of the chip's own clock."""
        if not self._is_set(self.TIMESTAMP_ENABLE):
            return 0
        rate = self.TICKS_PER_SECOND * (1 + self.specimen.odr_error)
        return int((t - self._timestamp_zero) * rate) & 0xFFFFFFFF

    def _store_sample(self, when: float) -> None:
        """Append the words of a sample to the FIFO; when it is full, drop the oldest or the newest words."""
        slots = (when - self._slot_time) * self.ODR_HZ[self._clock_code] * (1 + self.specimen.odr_error)
        self._slot_time = when
        self._tag_count = (self._tag_count + max(1, round(slots))) & 3
        mode, batch = self.values[FIFO_CTRL4] & 7, self.values[FIFO_CTRL3] & 0x0F
        if mode == _BYPASS_MODE or not batch:
            return
        if batch != self._clock_code:
            self._count_anomaly("unmodelled batch rate in", FIFO_CTRL3)
        words = [(TAG_GYRO, self._sample[:6]), (TAG_ACCEL, self._sample[6:])]
        if self.values[FIFO_CTRL4] >> 6 == 1:
            words.append((TAG_TIMESTAMP, self._timestamp(when).to_bytes(4, "little") + bytes(2)))
        for sensor, data in words:
            tag = sensor << 3 | self._tag_count << 1
            self._append_word(mode, bytes([tag | (tag.bit_count() & 1 if self.HAS_PARITY else 0)]) + data)

    _slot_time = 0.0

    def _append_word(self, mode: int, word: bytes) -> None:
        """Append a word to the FIFO."""
        fifo = self._fifo
        if len(fifo) == self.FIFO_WORDS * WORD_BYTES:
            self.fifo_dropped += 1
            self._overrun = True
            if mode == _FIFO_MODE:
                return
            del fifo[:WORD_BYTES]
        fifo += word

    def _pop_fifo(self, n: int, t: float, byte_time: float) -> bytes:
        """Remove n bytes from the FIFO and return them, with zeros beyond its end."""
        data = bytes(self._fifo[:n])
        del self._fifo[:n]
        if data:
            self._overrun = False
        if len(data) < n:
            self.anomalies["read of empty FIFO"] += 1
        return data + bytes(n - len(data))

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """Return a burst; whole words of the FIFO are read at once."""
        if self.pointer == FIFO_TAG and n % WORD_BYTES == 0 and self.increments_address:
            self._measure_until(t)
            return self._pop_fifo(n, t, byte_time)
        return super().read(t, n, byte_time)

    def read_register(self, t: float, register: int) -> int:
        """Return one byte, and apply the side effects of the read."""
        self._measure_before_read(t, register)
        if register in (self.FIFO_STATUS, self.FIFO_STATUS + 1):
            words = len(self._fifo) // WORD_BYTES
            if register == self.FIFO_STATUS:
                return words & 0xFF
            return (
                words >> 8 & 3
                | (0x48 if self._overrun else 0)
                | (0x20 if words >= self.FIFO_WORDS - 3 else 0)
            )
        if FIFO_TAG <= register <= FIFO_LAST:
            # The last byte of a word removes it.
            byte = self._fifo[register - FIFO_TAG] if self._fifo else 0
            if register == FIFO_LAST:
                self._pop_fifo(WORD_BYTES, t, 0.0)
            return byte
        if TIMESTAMP0 <= register < TIMESTAMP0 + 4:
            return self._timestamp(t) >> 8 * (register - TIMESTAMP0) & 0xFF
        if register in (0x3E, 0x3F):
            return self.values[register]
        return super().read_register(t, register)


class Lsm6dsr(Lsm6dso):
    """An LSM6DSR: an LSM6DSO with a range of 4000 deg/s (ST DS13030)."""

    chip_name = "lsm6dsr"
    IDENTITY = 0x6B
    REGISTERS = REGISTERS | {CTRL2_G: Register("CTRL2_G", 0x00, 0xFF)}
