"""Random drives of all kinds: vehicle, speed, standstills, road, slip, and every error of the nodes.

Each draws a vehicle (wheels of 5 to 35 cm), a top speed of 0.05 to 20 m/s, standstills of 0 to 120 s at the
start and in between, noise of half to ten times a data sheet's, flicker, tilts, lever arms, clocks and road;
every third goes over hills on a rough road, every fourth slips once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from generators import slip_drives, wheel_drives

FASTEST_SPIN = 33.0
"""rad/s; what is faster is clipped, which is another matter."""

STATED_RADIUS, STATED_SCALE = 0.004, 0.0122
"""1 sigma of the errors of radius and gyro scales that an uncalibrated vehicle is assumed to have; the drives
have 0.002 and 0.01."""


@dataclass(frozen=True)
class Drawn:
    """A drive and its description."""

    drive: wheel_drives.WheelDrive
    top_speed: float
    noise: float
    rested: float
    slips: bool
    hilly: bool


def drawn(seed: int, has_stated_errors: bool = False) -> Drawn:
    """Return the drive of a seed; has_stated_errors: radius and scales are as wrong as assumed."""
    rng = np.random.default_rng(seed)
    top = float(np.exp(rng.uniform(np.log(0.05), np.log(20.0))))
    radius = max(float(rng.uniform(0.05, 0.35)), 1.15 * top / FASTEST_SPIN)
    track = float(rng.uniform(3.0, 6.0)) * min(radius, 0.3)
    parts = [(float(rng.choice([0.5, 5.0, 20.0, 120.0])), 0.0, 0.0)]
    rested, moving = parts[0][0], 0.0
    while moving < 90.0:
        duration = float(rng.uniform(4.0, 15.0))
        speed = top * float(rng.uniform(0.4, 1.0)) * float(rng.choice([1.0, 1.0, 1.0, -0.3]))
        # Limit the lateral acceleration to 2 m/s² and the yaw rate to 0.6 rad/s.
        turn = min(0.6, 2.0 / max(abs(speed), 0.1)) * float(rng.uniform(-1.0, 1.0))
        parts.append((duration, speed, turn))
        moving += duration
        if rng.uniform() < 0.15:
            standstill_s = float(rng.choice([2.0, 10.0, 60.0]))
            parts.append((standstill_s, 0.0, 0.0))
            rested += standstill_s
    parts.append((4.0, 0.0, 0.0))
    plan = wheel_drives.ramps(parts)
    hilly = seed % 3 == 0 and top > 0.3
    if hilly:
        plan = slip_drives.hilly(plan, rng)
    fast = np.flatnonzero(np.abs(plan.speed) > 0.5 * top) / wheel_drives.RATE_HZ
    slips = seed % 4 == 0 and top > 0.5 and len(fast) > 0
    if slips:
        start = float(rng.choice(fast[len(fast) // 4 : -len(fast) // 4]))
        loss = float(rng.choice([-0.8, 0.8])) * top
        plan = wheel_drives.with_slip(
            plan, str(rng.choice(["left", "right"])), start, float(rng.uniform(1, 5)), loss
        )
    noise = float(np.exp(rng.uniform(np.log(0.5), np.log(10.0))))
    wide = float(rng.uniform(0.5, 2.0))
    errors = wheel_drives.Errors(
        noise=noise,
        tilt=np.radians(wide),
        arm=0.1 * radius * wide,
        clock=float(rng.choice([0.0, 0.003, 0.01])),
        flicker=float(rng.choice([0.0, 1e-4, 5e-4])),
        vibration=float(rng.choice([0.05, 0.3, 1.0])),
    )
    if has_stated_errors:
        errors = replace(errors, radius=STATED_RADIUS, scale=STATED_SCALE)
    rate = float(rng.choice([104.0, 208.0]))
    driven = wheel_drives.drive(plan, rng, errors, radius, track, rate_hz=rate)
    return Drawn(driven, top, noise, rested, slips, hilly)
