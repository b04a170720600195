"""Generate logs of a fleet quickly: vehicles, days, stationary nodes with a bias, gaps, a broken file."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle

MONDAY = datetime(2026, 6, 1, 6, tzinfo=UTC)
GYRO_STEP, ACCEL_STEP = 1.527e-4, 1.197e-3
"""rad/s and m/s² of one count of an LSM6DS33."""
NOISE = 3e-3
"""rad/s of a sample, 1 sigma, white."""


@dataclass(frozen=True)
class FleetLog:
    """A log of a fleet.

    day: days since MONDAY. bias: bias of the z gyro, rad/s; warming: initial bias that decays within 30 s.
    missing: number of samples omitted at two thirds of the log.
    """

    vehicle: str
    day: float
    seconds: float = 20.0
    rate: float = 100.0
    bias: float = 0.01
    warming: float = 0.0
    noise: float = NOISE
    missing: int = 0
    seed: int = 0
    nodes: tuple[str, ...] = ("left",)


def write(folder: Path, log: FleetLog) -> Path:
    """Write the log into the folder of its vehicle, named by its time."""
    rng = np.random.default_rng(log.seed)
    start = MONDAY + timedelta(days=log.day)
    t = np.arange(int(log.seconds * log.rate)) / log.rate
    recorded = np.ones(len(t), bool)
    at = 2 * len(t) // 3
    recorded[at : at + log.missing] = False
    nodes = {}
    for node in log.nodes:
        gyro = rng.normal((0.0, 0.0, log.bias), log.noise, (len(t), 3))
        gyro[:, 2] += log.warming * np.exp(-t / 30.0)
        accel = rng.normal((0.0, 0.0, 9.80665), 0.02, (len(t), 3))
        values = np.column_stack(
            [np.round(gyro / GYRO_STEP) * GYRO_STEP, np.round(accel / ACCEL_STEP) * ACCEL_STEP]
        )[recorded]
        names = ("gx", "gy", "gz", "ax", "ay", "az")
        nodes[node] = Table({"t": t[recorded], **dict(zip(names, values.T, strict=True))})
    path = folder / log.vehicle / f"{start:%Y%m%dT%H%M%S}-{log.seed}.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    recording = Recording(nodes=nodes, t_zero_ns=int(start.timestamp() * 1e9))
    write_recording(recording, path, vehicle=Vehicle(0.3, 0.9))
    return path


def cut(folder: Path, log: FleetLog) -> Path:
    """Write a log of which only a few bytes, not even MCAP magic, reached the disk."""
    path = write(folder, log)
    path.write_bytes(b"\0" * 4096)
    return path
