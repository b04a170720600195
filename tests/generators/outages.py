"""Wheel drives with outages of their nodes (radio, cable, battery) or pauses.

Made by `wheel_drives`, so without the model under test.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from generators import wheel_drives
from generators.wheel_drives import WheelDrive

SPEED, BEFORE, AFTER = 1.2, 12.0, 10.0
"""m/s before the silence, s of driving before and after it."""

MEANWHILE = {
    "goes on": [(1.0, SPEED, 0.0)],
    "brakes": [(0.1, SPEED, 0.0), (0.9, 0.0, 0.0)],
    "turns": [(1.0, SPEED, 0.35)],
    "speeds up": [(1.0, 1.8, -0.1)],
}
"""Fraction of the outage, speed in m/s, yaw rate in rad/s."""


def drive_with_outage(
    seed: int, seconds: float, meanwhile: str, standstill_s: float = 6.0
) -> tuple[WheelDrive, float]:
    """Return a drive at walking pace with an outage of both nodes of `seconds`, and the end of it, s."""
    rng = np.random.default_rng(seed)
    turn = float(rng.uniform(-0.2, 0.2))
    after = (AFTER, float(rng.uniform(0.8, 1.5)), float(rng.uniform(-0.3, 0.3)))
    parts = [(standstill_s, 0.0, 0.0), (BEFORE, SPEED, turn)]
    parts += [(share * seconds, speed, rate) for share, speed, rate in MEANWHILE[meanwhile]]
    drive = wheel_drives.drive(wheel_drives.legs([*parts, after, (2.0, 0.0, 0.0)]), rng)
    start = standstill_s + BEFORE + float(rng.uniform(-0.5, 0.5))
    for name, node in drive.nodes.items():
        # Both nodes are lost at once (cable or radio), apart from data in transit.
        own = start + float(rng.uniform(0.0, 0.05))
        keep = (node.t < own) | (node.t > own + seconds)
        drive.nodes[name] = replace(node, t=node.t[keep], gyro=node.gyro[keep], accel=node.accel[keep])
    return drive, start + seconds + 0.05


def paused_drive(seed: int, seconds: float, length: float = 40.0) -> tuple[WheelDrive, float, float]:
    """Return a drive of `length` m with a standstill in its middle, in which the clock advances by `seconds`.

    That is a pause of the stationary vehicle, or a jump of the clock. Also return the times of the middle and
    of the end, s.
    """
    rng = np.random.default_rng(seed)
    half = wheel_drives.loop(rng, 0.5 * length, 6.0)
    other = wheel_drives.loop(rng, 0.5 * length, 6.0)
    plan = replace(
        half,
        speed=np.concatenate([half.speed, other.speed]),
        yaw_rate=np.concatenate([half.yaw_rate, other.yaw_rate]),
    )
    drive = wheel_drives.drive(plan, rng)
    middle = len(half.speed) / wheel_drives.RATE_HZ + 1.5
    for name, node in drive.nodes.items():
        drive.nodes[name] = replace(node, t=np.where(node.t > middle, node.t + seconds, node.t))
    return drive, middle, float(drive.t[-1]) + seconds


def driven_during_outage(seed: int, seconds: float = 60.0) -> tuple[WheelDrive, float]:
    """Return a drive moved during an outage between two standstills, and the end of the outage, s."""
    rng = np.random.default_rng(seed)
    unrecorded = [(4.0, 0.0, 0.0), (seconds - 8.0, SPEED, 0.15), (4.0, 0.0, 0.0)]
    parts = [
        (6.0, 0.0, 0.0),
        (8.0, SPEED, 0.1),
        (5.0, 0.0, 0.0),
        *unrecorded,
        (5.0, 0.0, 0.0),
        (8.0, SPEED, -0.1),
    ]
    drive = wheel_drives.drive(wheel_drives.legs([*parts, (2.0, 0.0, 0.0)]), rng)
    start = 17.5
    for name, node in drive.nodes.items():
        keep = (node.t < start) | (node.t > start + seconds)
        drive.nodes[name] = replace(node, t=node.t[keep], gyro=node.gyro[keep], accel=node.accel[keep])
    return drive, start + seconds


def random_outage(seed: int) -> tuple[WheelDrive, float, float]:
    """Return a drive with an outage of all nodes of 0.5 to 5 s at 0.3 to 3 m/s, its start and its end, s."""
    rng = np.random.default_rng([seed, 34])
    speed = float(np.exp(rng.uniform(np.log(0.3), np.log(3.0))))
    seconds = float(rng.uniform(0.5, 5.0))
    # Limit the lateral acceleration to 1.5 m/s² and the yaw rate to 0.5 rad/s.
    sharpest = min(0.5, 1.5 / speed)
    turn = float(rng.choice([0.0, rng.uniform(-sharpest, sharpest)]))
    other = (speed, turn)
    if rng.uniform() < 0.5:
        other = speed * float(rng.uniform(0.7, 1.3)), float(rng.uniform(-sharpest, sharpest))
    driven = max(15.0, 12.0 / speed)
    parts = [(5.0, 0.0, 0.0), (4.0, speed, 0.5 * sharpest), (4.0, speed, -0.5 * sharpest)]
    parts += [(driven + 0.5 * seconds, speed, turn), (0.5 * seconds + 8.0, *other), (2.0, 0.0, 0.0)]
    drive = wheel_drives.drive(wheel_drives.legs(parts), rng)
    start = 13.0 + driven
    for name, node in drive.nodes.items():
        own = start + float(rng.uniform(0.0, 0.05))
        keep = (node.t < own) | (node.t > own + seconds)
        drive.nodes[name] = replace(node, t=node.t[keep], gyro=node.gyro[keep], accel=node.accel[keep])
    return drive, start, start + seconds + 0.05
