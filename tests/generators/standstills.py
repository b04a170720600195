"""Wheel drives with a standstill of any length, at the start or in the middle, and an idling engine.

Made by `wheel_drives`, so without the model under test.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from generators import wheel_drives
from generators.wheel_drives import WheelDrive

PER_SAMPLE = wheel_drives.GYRO_DENSITY * np.sqrt(52.0)
"""rad/s, 1 sigma of the generator's gyro at its usual 104 Hz."""

_IDLING_HZ = 25.0


def drive_with_standstill(
    seed: int, length: float, standstill_s: float, where: str, gyro_noise: float, idling: float = 0.0
) -> WheelDrive:
    """Once round in `length` m, with `rest` s of standing at the `start` or in the `middle`.

    gyro_noise: rad/s per sample; the accelerometers' grows with it. idling: rad/s rms of 25 Hz on every gyro
    axis all the time.
    """
    rng = np.random.default_rng(seed)
    plan = wheel_drives.loop(rng, length, 5.0)
    still, middle = np.zeros(int(standstill_s * wheel_drives.RATE_HZ)), len(plan.speed) // 2
    place, share = 0, np.ones(len(plan.speed))
    if where == "middle":
        # Down to nothing and up again in a second and a half each.
        distance_s = np.abs(np.arange(len(plan.speed)) - middle) / wheel_drives.RATE_HZ
        place, share = middle, 0.5 - 0.5 * np.cos(np.pi * np.clip(distance_s / 1.5, 0.0, 1.0))
    speed, yaw_rate = (
        np.concatenate([column[:place], still, column[place:]])
        for column in (share * plan.speed, share * plan.yaw_rate)
    )
    errors = replace(wheel_drives.Errors(), noise=gyro_noise / PER_SAMPLE)
    driven = wheel_drives.drive(replace(plan, speed=speed, yaw_rate=yaw_rate), rng, errors)
    nodes = {}
    for name, node in driven.nodes.items():
        phase = 2.0 * np.pi * _IDLING_HZ * node.t[:, None] + np.arange(3)
        nodes[name] = replace(node, gyro=node.gyro + idling * np.sqrt(2.0) * np.sin(phase))
    return replace(driven, nodes=nodes)
