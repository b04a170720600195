"""What every emulated IMU does alike: motion to output words on its own clock, and the truth of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.emulator.chips.faults import ScriptedFault
from hubodo.emulator.chips.registers import Register, RegisterChip
from hubodo.emulator.chips.sampling import ChipClock, Raw, Truth, quantise
from hubodo.emulator.motion import Motion

Disturbance = Callable[[Array, Array, Array, np.random.Generator], tuple[Array, Array]]
"""(t (n,) s, gyro (n, 3) rad/s, accel (n, 3) m/s^2, rng) to the gyro and accel that get quantised.

Called once for each run of consecutive samples, in order of time.
"""

DPS = math.pi / 180


@dataclass(frozen=True)
class Specimen:
    """What distinguishes one specimen from the data sheet.

    Attributes:
        odr_error: true sample rate is nominal * (1 + odr_error), within +-0.1.
        odr_per_degree: relative change of that rate per degC away from 25.
        disturbance: what is added to the true motion before quantisation, or None.
        seed: of the generator handed to `disturbance`.
        who_am_i: identity the specimen answers with; None for the usual one.
        strict: see RegisterChip.
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
            raise ValueError(f"odr_error {self.odr_error}: want -0.1 to 0.1")


class Imu(RegisterChip):
    """A six-axis chip: `sync` makes the samples that are due, a chip adds its registers and FIFO."""

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
        self.clock = ChipClock(
            6,
            odr_error=specimen.odr_error,
            odr_per_degree=specimen.odr_per_degree,
            temperature=motion.temperature,
            temperature_word=self.temperature_word,
            faults=specimen.faults,
        )
        self.fifo_dropped = 0
        super().__init__("imu", address, registers, who_am_i, specimen.faults, strict=specimen.strict)

    def temperature_word(self, degrees: Array) -> Raw:
        """The temperature register's word for (n,) degC."""
        raise NotImplementedError

    def begin(
        self,
        t: float,
        nominal_hz: float,
        gyro_lsb: float,
        accel_lsb: float,
        gyro_hold: int = 1,
        accel_hold: int = 1,
    ) -> None:
        """Sample from t on; `*_hold` = master samples between two of that sensor, 0 when it is off."""

        def measure(times: Array) -> Raw:
            gyro, accel = self.motion.angular_rate(times), self.motion.specific_force(times)
            if self.specimen.disturbance is not None:
                gyro, accel = self.specimen.disturbance(times, gyro, accel, self._rng)
            raw = np.concatenate([quantise(gyro, gyro_lsb), quantise(accel, accel_lsb)], axis=1)
            return self._held(raw, gyro_hold, accel_hold)

        lsb = np.array([gyro_lsb] * 3 + [accel_lsb] * 3)
        self._last_row = np.zeros(6, dtype=np.int16)
        self._row = 0
        self.clock.start(t, nominal_hz, measure, lsb)

    def _held(self, raw: Raw, gyro_hold: int, accel_hold: int) -> Raw:
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

    def truth(self) -> Truth:
        """What this chip has made so far."""
        return self.clock.truth(self.fifo_dropped)

    def quantised_samples(self) -> Raw:
        """(n, 6) int16: gyro x y z, accel x y z, every sample made so far."""
        return self.truth().raw


def dps_lsb(degrees_per_second: float) -> float:
    """rad/s per LSB from deg/s per LSB."""
    return degrees_per_second * DPS


def g_lsb(g: float) -> float:
    """m/s^2 per LSB from g per LSB."""
    return g * STANDARD_GRAVITY
