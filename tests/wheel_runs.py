"""Run drives of `generators.wheel_drives` through the wheel filter and return errors at the end."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.fuse.wheel.calibration.held_out import ErrorSummary, HeldOutErrors
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.preintegration import WheelSample
from hubodo.fuse.wheel.track import WheelRun, WheelTrack
from hubodo.fuse.wheel.window import WINDOW_S
from hubodo.recording import Table

BOTH = ("left", "right")
_COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")


def tables(drive: wheel_drives.WheelDrive) -> dict[str, Table]:
    """Return the tables that the nodes recorded."""
    return {
        name: Table(dict(zip(_COLUMNS, np.column_stack([node.t, node.gyro, node.accel]).T, strict=True)))
        for name, node in drive.nodes.items()
    }


def config(
    drive: wheel_drives.WheelDrive,
    names: tuple[str, ...] = BOTH,
    facing: dict[str, str] | None = None,
    limits: dict[str, float] | None = None,
    **changes: object,
) -> WheelConfig:
    """Return the filter's settings for a drive with the declared vehicle; limits: where nodes clip."""
    nodes = {
        name: WheelNode(name, (facing or {}).get(name, "left"), **(limits or {}))  # type: ignore[arg-type]
        for name in names
    }
    return replace(WheelConfig(drive.radius, drive.track, nodes), **changes)  # type: ignore[arg-type]


def sample_columns(drive: wheel_drives.WheelDrive) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return times, gyro and accelerometer samples of each node, for `WheelFilter.handle_blocks`."""
    return {name: (node.t, node.gyro, node.accel) for name, node in drive.nodes.items()}


def samples_in_time_order(columns: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> list[WheelSample]:
    """Return the samples of all nodes, as of `sample_columns`, one by one, sorted by time."""
    samples = [
        WheelSample(name, t, tuple(gyro), tuple(accel))
        for name, node_columns in columns.items()
        for t, gyro, accel in zip(*(column.tolist() for column in node_columns), strict=True)
    ]
    return sorted(samples, key=lambda sample: sample.t)


def skip_held_out_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the held-out segments of a wheel calibration, which take most of its time."""
    module = "hubodo.fuse.wheel.calibration.calibrate.measure_held_out_errors"
    zero = ErrorSummary(0.0, 0.0)
    monkeypatch.setattr(module, lambda *_: HeldOutErrors(zero, zero, 0))


def short_loop(seed: int, **options: object) -> wheel_drives.WheelDrive:
    """Return a loop of 25 m."""
    rng = np.random.default_rng(seed)
    return wheel_drives.drive(wheel_drives.loop(rng, 25.0, 5.0), rng, **options)  # type: ignore[arg-type]


def true_pose(drive: wheel_drives.WheelDrive, t: float) -> np.ndarray:
    """Return x, y, heading at time t, (3,)."""
    return np.array([np.interp(t, drive.t, column) for column in (drive.x, drive.y, drive.heading)])


def end_error(drive: wheel_drives.WheelDrive, run: WheelRun) -> float:
    """Return the distance in m between the end of a track and the truth."""
    return float(np.hypot(*_error(drive, run.track, -1)[:2]))


def nees(drive: wheel_drives.WheelDrive, run: WheelRun) -> float:
    """Return the NEES of x, y, heading at the end: chi-square with 3 degrees of freedom if consistent."""
    error = _error(drive, run.track, -1)
    return float(error @ np.linalg.solve(run.track.covariance[-1, :3, :3], error))


def pose_error(drive: wheel_drives.WheelDrive, track: WheelTrack, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the error (3,) of x, y and heading (wrapped) of one pose, and its covariance (3, 3)."""
    error = _error(drive, track, at)
    error[2] = math.remainder(error[2], 2.0 * math.pi)
    return error, track.covariance[at, :3, :3]


def _error(drive: wheel_drives.WheelDrive, track: WheelTrack, at: int) -> np.ndarray:
    """Return the error of x, y and heading, (3,), relative to the first complete window."""
    start = true_pose(drive, track.t[0] - WINDOW_S)
    x, y, heading = true_pose(drive, track.t[at]) - start
    displacement = complex(x, y) * cmath.exp(-1j * start[2])
    return np.array(
        [track.x[at] - displacement.real, track.y[at] - displacement.imag, track.heading[at] - heading]
    )
