"""Drives whose sensors clip: too fast for the gyro about the axle, or for the accelerometers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from generators.wheel_drives import ACCEL_STEP, GRAVITY, Ends, Errors, WheelDrive, drive, ramps

WIDE = Ends(np.radians(2000.0))
"""Sensor ranges: 2000 deg/s and 16 g, as of an MPU-6050."""


@dataclass(frozen=True)
class Clipped:
    """A case of clipping.

    speed: m/s, at which sensors clip; hardest: largest acceleration of the ramps to it, m/s²; ends:
    saturation limits of the sensors; radius, track: m; rate_hz: sample rate; begins: True if the drive begins
    at that speed; bumps: see `Errors`; arm: lever arm, m.
    """

    speed: float
    hardest: float = 2.5
    ends: Ends = WIDE
    radius: float = 0.3
    track: float = 0.6
    rate_hz: float = 104.0
    begins: bool = False
    bumps: float = 1.0
    arm: tuple[float, float] | None = None

    @property
    def limits(self) -> dict[str, float]:
        """Clipping limits just below the ranges, for `WheelNode`."""
        return {"gyro_limit": 0.998 * self.ends.gyro, "accel_limit": 0.998 * self.ends.accel}


CASES = {
    "15 m/s": Clipped(15.0),
    "15 m/s, 208 Hz": Clipped(15.0, rate_hz=208.0),
    "20 m/s": Clipped(20.0),
    "20 m/s, 208 Hz": Clipped(20.0, rate_hz=208.0),
    "20 m/s, braked at 7 m/s²": Clipped(20.0, hardest=7.0),
    "20 m/s from the start": Clipped(20.0, begins=True),
    "500 °/s at 4 m/s": Clipped(4.0, 1.0, Ends(np.radians(500.0)), 0.15, 0.5),
    "±4 g at 12 m/s": Clipped(12.0, ends=Ends(accel=4.0 * GRAVITY), arm=(0.02, -0.015)),
    "±16 g at 12 m/s": Clipped(12.0, ends=Ends(accel=2**15 * ACCEL_STEP), arm=(0.02, -0.015)),
}


def clipped_drive(case: Clipped, seed: int, errors: Errors | None = None) -> WheelDrive:
    """Return slow legs with bends, a fast leg with one bend, braking, a second fast leg, and a stop."""
    rng = np.random.default_rng(seed)
    v, slow = case.speed, 0.35 * case.speed
    turns = rng.uniform(-1.0, 1.0, 6) * np.array([0.5, 0.5, 1.5 / v, 1.5 / v, 0.5, 1.5 / v])
    fast = [(12.0, v, turns[2]), (6.0, v, 0.0), (5.0, slow, turns[4]), (12.0, v, turns[5]), (3.0, v, 0.0)]
    slowly = [(8.0, 0.0, 0.0), (8.0, slow, turns[0]), (8.0, slow, turns[1])]
    parts = fast if case.begins else slowly + fast
    parts.append((v / case.hardest + 4.0, 0.0, 0.0))
    plan = ramps(parts, case.hardest, v if case.begins else 0.0)
    errors = errors or Errors(bumps=case.bumps)
    return drive(
        plan, rng, errors, case.radius, case.track, rate_hz=case.rate_hz, arm=case.arm, ends=case.ends
    )
