"""Base of the emulated magnetometers: the field is sampled while the chip measures continuously."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hubodo.arrays import Array
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.registers import Register, RegisterChip
from hubodo.emulator.chips.sampling import ChipSamples, RawWords, SampleClock, quantise
from hubodo.emulator.motion import Motion

TESLA_PER_GAUSS = 1e-4


class Magnetometer(RegisterChip):
    """A magnetometer in the magnetic field of `motion`, in node axes; a subclass adds `lsb` and registers."""

    def __init__(
        self,
        motion: Motion,
        specimen: Specimen | None,
        address: int,
        registers: Mapping[int, Register],
        who_am_i: tuple[int, int],
        temperature_word: Callable[[Array], RawWords],
    ) -> None:
        """Start powered down; registers, who_am_i: as for `RegisterChip`; temperature_word: words of °C."""
        specimen = specimen or Specimen()
        self.motion = motion
        self._sample, self._status = bytes(6), 0
        faults = tuple(f for f in specimen.faults if getattr(f, "chip", "mag") == "mag")
        self.clock = SampleClock(
            3,
            odr_error=0.0,
            odr_per_degree=0.0,
            temperature=motion.temperature,
            temperature_word=temperature_word,
            faults=faults,
        )
        super().__init__("mag", address, dict(registers), who_am_i, faults, strict=specimen.strict)

    def power_on(self, t: float) -> None:
        """Reset the registers at t: no samples until the chip is configured."""
        super().power_on(t)
        self.clock.stop()
        self._sample, self._status = bytes(6), 0

    @property
    def lsb(self) -> float:
        """Resolution at the current range, T per LSB."""
        raise NotImplementedError

    def start_measuring(self, t: float, rate_hz: float) -> None:
        """Sample continuously from t on, at the current range."""
        lsb = self.lsb
        self.clock.start(
            t, rate_hz, lambda times: quantise(self.motion.magnetic_field(times), lsb), np.full(3, lsb)
        )

    def truth(self) -> ChipSamples:
        """Return all samples so far."""
        return self.clock.truth()
