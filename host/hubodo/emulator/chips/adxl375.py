"""Emulated ADXL375: an accelerometer of 200 g, in standby at reset, with a FIFO of 32 samples."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.registers import Register, RegisterChip
from hubodo.emulator.chips.sampling import ChipSamples, RawWords, SampleClock
from hubodo.emulator.motion import Motion

DEVID, BW_RATE, POWER_CTL, INT_SOURCE, DATA_FORMAT = 0x00, 0x2C, 0x2D, 0x30, 0x31
DATA, FIFO_CTL, FIFO_STATUS = 0x32, 0x38, 0x39
FIFO_SAMPLES = 32
LSB = 0.049 * STANDARD_GRAVITY
MAX_STEPS = 4096
"""The output ends beyond 200 g."""
_MEASURE, _STREAM, _BYPASS, _REQUIRED_FORMAT = 0x08, 2, 0, 0x0B

REGISTERS: dict[int, Register] = {
    DEVID: Register("DEVID", 0xE5),
    **{0x1E + i: Register(f"OFS{axis}", 0x00, 0xFF) for i, axis in enumerate("XYZ")},
    BW_RATE: Register("BW_RATE", 0x0A, 0x1F),
    POWER_CTL: Register("POWER_CTL", 0x00, 0x3F),
    0x2E: Register("INT_ENABLE", 0x00, 0xFF),
    0x2F: Register("INT_MAP", 0x00, 0xFF),
    INT_SOURCE: Register("INT_SOURCE"),
    DATA_FORMAT: Register("DATA_FORMAT", 0x00, 0xEF),
    **{DATA + i: Register(f"DATA_{i}") for i in range(6)},
    FIFO_CTL: Register("FIFO_CTL", 0x00, 0xFF),
    FIFO_STATUS: Register("FIFO_STATUS"),
}


class Adxl375(RegisterChip):
    """An ADXL375 that is moved by `motion`, in node axes.

    Register map, codes and scale: Analog Devices ADXL375 data sheet. Not modelled: interrupts, shocks,
    noise, offsets and the 10 % by which the scale of a specimen may differ; FIFO modes other than bypass
    and stream (counted).
    """

    def __init__(self, motion: Motion, specimen: Specimen | None = None, *, address: int = 0x53) -> None:
        specimen = specimen or Specimen()
        self.motion = motion
        self.fifo_dropped = 0
        faults = tuple(f for f in specimen.faults if getattr(f, "chip", "high_g") == "high_g")
        self.clock = SampleClock(
            3,
            odr_error=-specimen.odr_error,
            odr_per_degree=0.0,
            temperature=motion.temperature,
            temperature_word=lambda degrees: np.zeros(len(degrees), np.int16),
            faults=faults,
        )
        super().__init__("high_g", address, REGISTERS, (DEVID, 0xE5), faults, strict=specimen.strict)

    def power_on(self, t: float) -> None:
        """Reset the registers at t: no samples until the chip is set to measure."""
        super().power_on(t)
        self.clock.stop()
        self._fifo: list[bytes] = []
        self._sample = bytes(6)

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a control register that changed."""
        self._measure_until(t)
        if register == FIFO_CTL:
            self._fifo.clear()
            if self.values[FIFO_CTL] >> 6 not in (_BYPASS, _STREAM):
                self._count_anomaly("unmodelled mode in", register)
        elif register in (POWER_CTL, BW_RATE):
            self.clock.stop()
            if self.values[POWER_CTL] & _MEASURE:
                if self.values[DATA_FORMAT] != _REQUIRED_FORMAT:
                    self._count_anomaly("invalid format in", DATA_FORMAT)
                rate_hz = 3200.0 / (1 << 15 - (self.values[BW_RATE] & 15))
                self.clock.start(t, rate_hz, self._measure, np.full(3, LSB))

    def _measure(self, times: Array) -> RawWords:
        steps = np.rint(self.motion.specific_force(times) / LSB)
        return np.clip(steps, -MAX_STEPS, MAX_STEPS - 1).astype(np.int16)

    def _measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        for sample in self.clock.samples_until(t):
            self._fifo.append(sample[1])
            limit = FIFO_SAMPLES if self.values[FIFO_CTL] >> 6 == _STREAM else 1
            if len(self._fifo) > limit:
                self._fifo.pop(0)
                self.fifo_dropped += 1

    def read_register(self, t: float, register: int) -> int:
        """Return one byte; the first of the data takes the oldest sample from the FIFO."""
        self._measure_until(t)
        if register == FIFO_STATUS:
            return len(self._fifo)
        if register == DATA and self._fifo:
            self._sample = self._fifo.pop(0)
        if DATA <= register < DATA + 6:
            return self._sample[register - DATA]
        return self.values[register]

    def truth(self) -> ChipSamples:
        """Return all samples so far."""
        return self.clock.truth(self.fifo_dropped)
