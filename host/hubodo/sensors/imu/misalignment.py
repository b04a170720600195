"""Alignment of the gyro triad to the accelerometer triad by the angle between gravity and Earth rate.

The scalar method does not determine the rotation of a triad. The angle between gravity f and Earth rate
Omega is the same in every pose: f . Omega = g Omega sin(latitude). From it follow the three small rotation
angles between the triads, and with them all six gyro misalignments in the accelerometer's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.earth import EARTH_RATE
from hubodo.errors import CalibrationError

MAX_CONDITION_NUMBER = 300.0
"""Largest condition number: at this value an error of 1e-3 in the direction of Earth rate becomes 0.3 rad."""


@dataclass(frozen=True)
class TriadAlignment:
    """The rotation from the frame of the gyro triad to that of the accelerometer triad.

    Attributes:
        angle: (3,) rotation vector, rad.
        covariance: (3, 3) rad².
        residual: (R,) of the cosine of the angle between gravity and Earth rate.
        condition: condition number of the equations.
    """

    angle: Array
    covariance: Array
    residual: Array
    condition: float


def align_by_earth_rate(
    force: Array, rate: Array, rate_sigma: Array | float, latitude: float
) -> TriadAlignment:
    """Rotate the gyro frame such that gravity and Earth rate enclose 90 degrees minus latitude in every pose.

    force: (R, 3) calibrated accelerometer means, m/s². rate: (R, 3) gyro means after the scalar
    calibration, rad/s. rate_sigma: standard error of their norm, rad/s. latitude: rad. Raises
    CalibrationError if east lies in one plane of the node in all poses, because one angle is then
    unobservable.
    """
    up_vectors = force / np.linalg.norm(force, axis=1)[:, None]
    earth_vectors = rate / np.linalg.norm(rate, axis=1)[:, None]
    sigma = max(float(np.sqrt(np.mean(np.square(rate_sigma)))) / EARTH_RATE, 1e-12)
    angle = np.zeros(3)
    for _ in range(20):
        rotated = earth_vectors @ Rotation.from_rotvec(angle).as_matrix().T
        rows = np.cross(rotated, up_vectors)
        residual = np.sin(latitude) - (rotated * up_vectors).sum(axis=1)
        singular_values = np.linalg.svd(rows, compute_uv=False)
        condition = (
            float(singular_values[0] / singular_values[-1])
            if len(rows) >= 3 and singular_values[-1] > 0
            else np.inf
        )
        if condition > MAX_CONDITION_NUMBER:
            raise CalibrationError(
                f"the {len(rows)} poses do not determine the rotation between gyro and accelerometer triad "
                f"(condition number {condition:.2g}); repeat some poses turned about the vertical by 90 "
                "degrees"
            )
        step = np.linalg.lstsq(rows, residual, rcond=None)[0]
        angle = (Rotation.from_rotvec(step) * Rotation.from_rotvec(angle)).as_rotvec()
        if np.abs(step).max() < 1e-13:
            break
    dof = max(1, len(rows) - 3)
    scatter = max(sigma, float(np.sqrt((residual**2).sum() / dof)))
    return TriadAlignment(angle, np.linalg.inv(rows.T @ rows) * scatter**2, residual, condition)


def rotate_triad(triad: Triad, angle: Array) -> Triad:
    """Return the triad for true values in a frame rotated by `angle`: true_new = R true, M_new = M R'."""
    return Triad(triad.bias, np.asarray(triad.matrix @ Rotation.from_rotvec(angle).as_matrix().T))
