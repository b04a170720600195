"""Base class of emulated IMUs: it samples a motion on its own clock and records the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.emulator.chips.faults import ScriptedFault
from hubodo.emulator.chips.registers import Register, RegisterChip
from hubodo.emulator.chips.sampling import ChipSamples, RawWords, SampleClock, quantise
from hubodo.emulator.motion import Motion

Disturbance = Callable[[Array, Array, Array, np.random.Generator], tuple[Array, Array]]
"""Function of (t (n,) s, gyro (n, 3) rad/s, accel (n, 3) m/s², rng) that returns disturbed gyro and accel.

Called once for each run of consecutive samples, in order of time.
"""

RAD_PER_DEG = math.pi / 180


@dataclass(frozen=True)
class Specimen:
    """Deviations of one specimen of a chip from its data sheet.

    Attributes
    ----------
    odr_error : relative error of the sample rate, within ±0.1.
    odr_per_degree : relative change of the sample rate per °C from 25 °C.
    disturbance : function that adds errors to the true motion before quantisation, or None.
    seed : seed of the generator passed to `disturbance`.
    who_am_i : value of the identity register; None for the documented one.
    strict : see `RegisterChip`.
    faults : scripted faults.
    """

    odr_error: float = 0.0
    odr_per_degree: float = 0.0
    disturbance: Disturbance | None = None
    seed: int = 0
    who_am_i: int | None = None
    strict: bool = False
    faults: tuple[ScriptedFault, ...] = field(default=())

    def __post_init__(self) -> None:
        if not -0.1 <= self.odr_error <= 0.1:
            raise ValueError(f"odr_error {self.odr_error}: must be within ±0.1")


class Imu(RegisterChip):
    """A six-axis IMU; a subclass adds its registers and FIFO.

    A new chip is one file with a subclass, and one line in `chips.catalogue.IMU_CHIPS`.
    """

    chip_name: str
    """Name in `SensorBoard.chip`."""

    def __init__(
        self,
        motion: Motion,
        specimen: Specimen,
        address: int,
        registers: dict[int, Register],
        who_am_i: tuple[int, int],
    ) -> None:
        self.motion, self.specimen = motion, specimen
        self._rng = np.random.default_rng(specimen.seed)
        self.clock = SampleClock(
            6,
            odr_error=specimen.odr_error,
            odr_per_degree=specimen.odr_per_degree,
            temperature=motion.temperature,
            temperature_word=self.temperature_word,
            faults=specimen.faults,
        )
        self.fifo_dropped = 0
        super().__init__("imu", address, registers, who_am_i, specimen.faults, strict=specimen.strict)

    def temperature_word(self, degrees: Array) -> RawWords:
        """Return the words of the temperature register for (n,) °C."""
        raise NotImplementedError

    def start_sampling(
        self,
        t: float,
        nominal_hz: float,
        gyro_lsb: float,
        accel_lsb: float,
        gyro_hold: int = 1,
        accel_hold: int = 1,
    ) -> None:
        """Sample from t on at `nominal_hz`.

        `gyro_hold`, `accel_hold`: clock ticks between two samples of that sensor; 0 when it is off.
        """

        def measure(times: Array) -> RawWords:
            gyro, accel = self.motion.angular_rate(times), self.motion.specific_force(times)
            if self.specimen.disturbance is not None:
                gyro, accel = self.specimen.disturbance(times, gyro, accel, self._rng)
            raw = np.concatenate([quantise(gyro, gyro_lsb), quantise(accel, accel_lsb)], axis=1)
            return self._hold_samples(raw, gyro_hold, accel_hold)

        lsb = np.array([gyro_lsb] * 3 + [accel_lsb] * 3)
        self._last_row = np.zeros(6, dtype=np.int16)
        self._row = 0
        self.clock.start(t, nominal_hz, measure, lsb)

    def _hold_samples(self, raw: RawWords, gyro_hold: int, accel_hold: int) -> RawWords:
        """Repeat the last sample of a sensor that is slower than the clock; zero one that is off."""
        if gyro_hold == accel_hold == 1:
            return raw
        for columns, hold in ((slice(0, 3), gyro_hold), (slice(3, 6), accel_hold)):
            if hold == 0:
                raw[:, columns] = 0
            elif hold > 1:
                index = np.arange(self._row, self._row + len(raw))
                source = index - index % hold - self._row
                held = np.where(
                    source[:, None] >= 0, raw[np.maximum(source, 0), columns], self._last_row[columns]
                )
                raw[:, columns] = held
        self._last_row = raw[-1].copy()
        self._row += len(raw)
        return raw

    def interrupt_level(self, t: float) -> int:
        """Return the level of INT1 at t, s; 0 for a chip whose interrupts are not emulated."""
        return 0

    def truth(self) -> ChipSamples:
        """Return all samples so far."""
        return self.clock.truth(self.fifo_dropped)

    def quantised_samples(self) -> RawWords:
        """Return all samples so far, (n, 6) int16: gyro x y z, accel x y z."""
        return self.truth().raw


def rad_per_lsb(degrees_per_second: float) -> float:
    """Convert a resolution from deg/s per LSB to rad/s per LSB."""
    return degrees_per_second * RAD_PER_DEG


def accel_per_lsb(g: float) -> float:
    """Convert a resolution from g per LSB to m/s² per LSB."""
    return g * STANDARD_GRAVITY
