"""Drives in which the pose of the live odometry is set midway: normalised error of the pose at the end."""

from __future__ import annotations

import numpy as np

from generators import wheel_drives
from generators.fake_drive import RADIUS, TRACK
from generators.wheel_drives import WheelDrive
from hubodo.fuse.wheel.entries import TRACK_WIDTH, WHEEL_RADIUS
from hubodo.ingest.live.odometer import Odometer
from hubodo.log.records import ImuBlock
from hubodo.vehicle import NodeMount, Vehicle

VEHICLE = Vehicle(RADIUS, TRACK, {name: NodeMount(name, "left") for name in ("left", "right")})
SIGMAS = np.array([0.05, 0.1, 0.02])
"""m, m, rad: of a pose as a docking station or a marker gives it."""
_SET_AT, _SAMPLES, _RATE_HZ = 6.0, 8, 104.0
_PLAN = [(2.0, 0.0, 0.0), (6.0, 1.2, 0.25), (6.0, 1.2, -0.3), (4.0, -1.0, 0.2), (1.0, 0.0, 0.0)]


def drive_blocks(drive: WheelDrive) -> list[ImuBlock]:
    """Return the blocks of samples of a drive in the order of their newest samples."""
    blocks = []
    for name, node in drive.nodes.items():
        t_ns = np.round(node.t * 1e9).astype(np.int64)
        for first in range(0, len(t_ns), _SAMPLES):
            rows = slice(first, first + _SAMPLES)
            blocks.append(ImuBlock(name, node.gyro[rows], node.accel[rows], None, 0, t_ns=t_ns[rows]))
    return sorted(blocks, key=lambda block: int(block.t_ns[-1]))


def pose_nees(seed: int) -> float:
    """Return the NEES of the last pose of a drive; three degrees of freedom.

    At 6 s the pose is set in another frame, turned by 1 rad, with an error drawn from `SIGMAS`. The errors of
    sensors and vehicle are drawn from the priors of the filter.
    """
    rng = np.random.default_rng(seed)
    errors = wheel_drives.Errors(radius=WHEEL_RADIUS.prior, track=TRACK_WIDTH.prior)
    drive = wheel_drives.drive(wheel_drives.legs(_PLAN), rng, errors, RADIUS, TRACK, rate_hz=_RATE_HZ)
    turn, offset, odometer = 1.0, complex(40.0, -7.0), Odometer(VEHICLE, 0, rate_hz=20.0)
    error, is_set, last = SIGMAS * rng.standard_normal(3), False, None

    def true_pose(t: float) -> np.ndarray:
        x, y, heading = (np.interp(t, drive.t, values) for values in (drive.x, drive.y, drive.heading))
        position = offset + complex(x, y) * np.exp(1j * turn)
        return np.array([position.real, position.imag, heading + turn])

    for block in drive_blocks(drive):
        for rows in odometer.handle(block):
            last = rows
        if not is_set and last is not None and last.t_ns[-1] >= _SET_AT * 1e9:
            is_set = True
            odometer.set_pose(*(true_pose(last.t_ns[-1] * 1e-9) + error), np.diag(SIGMAS**2))
    difference = np.array([*last.position[-1], last.heading[-1]]) - true_pose(last.t_ns[-1] * 1e-9)
    return float(difference @ np.linalg.solve(last.pose_covariance[-1], difference))
