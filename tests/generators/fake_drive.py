"""A drive as raw steps of two fake nodes, and as a recording; made by `wheel_drives`, seed by seed."""

from __future__ import annotations

import numpy as np

from generators.wheel_drives import ACCEL_STEP, GYRO_STEP, Errors, WheelDrive, drive, legs
from vehicles import vehicle_toml

RADIUS, TRACK = 0.15, 0.5
VEHICLE_TOML = vehicle_toml(RADIUS, TRACK)


def short_drive(seed: int, rate_hz: float = 208.0, errors: Errors | None = None) -> WheelDrive:
    """Rest, a bend to the left, one to the right, rest: 11 s."""
    plan = legs([(2.0, 0.0, 0.0), (4.0, 1.2, 0.3), (4.0, 1.2, -0.4), (1.0, 0.0, 0.0)])
    return drive(plan, np.random.default_rng(seed), errors, RADIUS, TRACK, rate_hz=rate_hz)


def raw_rows(drive_: WheelDrive, node: str) -> list[tuple[int, ...]]:
    """The samples of a node in steps of the chip, for `FakeNode.rows`."""
    table = drive_.nodes[node]
    steps = np.hstack([np.round(table.gyro / GYRO_STEP), np.round(table.accel / ACCEL_STEP)])
    return [tuple(row) for row in np.clip(steps, -32768, 32767).astype(int).tolist()]
