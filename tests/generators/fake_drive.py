"""A seeded drive of `wheel_drives` as raw counts of two fake nodes, and as a recording."""

from __future__ import annotations

import numpy as np

from generators.wheel_drives import ACCEL_STEP, GYRO_STEP, Errors, WheelDrive, drive, legs
from vehicles import vehicle_toml

RADIUS, TRACK = 0.15, 0.5
VEHICLE_TOML = vehicle_toml(RADIUS, TRACK, more='radius_from = "rolled"\n')


def short_drive(seed: int, rate_hz: float = 208.0, errors: Errors | None = None) -> WheelDrive:
    """Return a drive of 11 s: standstill, left bend, right bend, standstill."""
    plan = [(2.0, 0.0, 0.0), (4.0, 1.2, 0.3), (4.0, 1.2, -0.4), (1.0, 0.0, 0.0)]
    return planned_drive(plan, seed, rate_hz, errors)


def planned_drive(
    plan: list[tuple[float, float, float]], seed: int, rate_hz: float, errors: Errors | None = None
) -> WheelDrive:
    """Return a drive of legs (duration s, speed m/s, yaw rate rad/s)."""
    return drive(legs(plan), np.random.default_rng(seed), errors, RADIUS, TRACK, rate_hz=rate_hz)


def raw_rows(drive_: WheelDrive, node: str) -> list[tuple[int, ...]]:
    """Return the samples of a node in counts of the chip, for `FakeNode.rows`."""
    table = drive_.nodes[node]
    steps = np.hstack([np.round(table.gyro / GYRO_STEP), np.round(table.accel / ACCEL_STEP)])
    return [tuple(row) for row in np.clip(steps, -32768, 32767).astype(int).tolist()]
