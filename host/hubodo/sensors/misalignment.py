"""Single misalignments beyond the scalar method: the gyro triad turned onto the accelerometer triad.

The scalar method leaves each triad free to be turned as a whole. What Avrutov leaves for later is seen here
from the angle between gravity and Earth rate, which is the same in every pose: f . Omega = g Omega
sin(latitude). Three small angles of the gyro triad against the accelerometer triad follow, and with them all
six gyro misalignments in the accelerometer's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.earth import EARTH_RATE
from hubodo.errors import CalibrationError

CONDITION_LIMIT = 300.0
"""Errors of 1e-3 in the direction of Earth rate would then spoil an angle by a third of a radian."""


@dataclass(frozen=True)
class TriadAlignment:
    """Rotation from the gyro triad's frame to the accelerometer triad's, as a rotation vector.

    angle: (3,) rad. covariance: (3, 3). residual: (R,) of the cosine of the angle between both vectors.
    condition: of the equations.
    """

    angle: Array
    covariance: Array
    residual: Array
    condition: float


def align_by_earth_rate(
    force: Array, rate: Array, rate_sigma: Array | float, latitude: float
) -> TriadAlignment:
    """Turn the gyro frame until gravity and Earth rate enclose 90 degrees less latitude in every pose.

    force: (R, 3) calibrated accelerometer means. rate: (R, 3) gyro means after the scalar calibration, rad/s.
    rate_sigma: 1 sigma of their length, rad/s. Raises CalibrationError when all poses have east in one plane
    of the node, so that one angle cannot be seen.
    """
    up = force / np.linalg.norm(force, axis=1)[:, None]
    earth = rate / np.linalg.norm(rate, axis=1)[:, None]
    sigma = max(float(np.sqrt(np.mean(np.square(rate_sigma)))) / EARTH_RATE, 1e-12)
    angle = np.zeros(3)
    for _ in range(20):
        turned = earth @ Rotation.from_rotvec(angle).as_matrix().T
        rows = np.cross(turned, up)
        residual = np.sin(latitude) - (turned * up).sum(axis=1)
        values = np.linalg.svd(rows, compute_uv=False)
        condition = float(values[0] / values[-1]) if len(rows) >= 3 and values[-1] > 0 else np.inf
        if condition > CONDITION_LIMIT:
            raise CalibrationError(
                f"the {len(rows)} poses do not show how the gyro triad is turned against the accelerometer "
                f"triad "
                f"(condition number {condition:.2g}); repeat some poses turned about the vertical by 90 "
                f"degrees"
            )
        step = np.linalg.lstsq(rows, residual, rcond=None)[0]
        angle = (Rotation.from_rotvec(step) * Rotation.from_rotvec(angle)).as_rotvec()
        if np.abs(step).max() < 1e-13:
            break
    freedom = max(1, len(rows) - 3)
    scatter = max(sigma, float(np.sqrt((residual**2).sum() / freedom)))
    return TriadAlignment(angle, np.linalg.inv(rows.T @ rows) * scatter**2, residual, condition)


def turned(triad: Triad, angle: Array) -> Triad:
    """The same triad for true values given in a frame turned by `angle`.

    true_new = R true_old, so M_new = M R'.
    """
    return Triad(triad.bias, np.asarray(triad.matrix @ Rotation.from_rotvec(angle).as_matrix().T))
