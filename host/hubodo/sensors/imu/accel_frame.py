"""Effect of accelerometer calibration errors on gyros that are calibrated against gravity.

The accelerometers define the direction of gravity before and after each turn. An error of their
calibration affects all turns in the same way, so the scatter of the turns does not include it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.sensors.imu.scalar_calibration import ScalarCalibration
from hubodo.sensors.imu.standstills import Standstills
from hubodo.sensors.imu.turn_calibration import TurnCalibration
from hubodo.sensors.imu.turns import Turns, propagate_gravity


def accel_frame_covariance(
    calibration: TurnCalibration, turns: Turns, standstills: Standstills, accel: ScalarCalibration
) -> Array:
    """Return the (12, 12) covariance of gyro bias and M (row by row) due to the accelerometers.

    This covariance is added to that of the turns. turns: all turns between the standstills. The effect is
    computed to first order for each principal direction of the accelerometers' covariance.
    """
    turns_used = turns.select(calibration.used)
    misclosure = propagate_gravity(turns_used, calibration.matrix, calibration.bias_change) - turns_used.end
    values, vectors = np.linalg.eigh(accel.full_covariance)
    covariance = np.zeros((12, 12))
    for direction in (vectors * np.sqrt(np.maximum(values, 0.0))).T:
        triad = Triad(accel.triad.bias + direction[:3], accel.triad.matrix + direction[3:].reshape(3, 3))
        up = np.asarray(replace(accel, triad=triad).correct(standstills.accel))
        up /= np.linalg.norm(up, axis=1)[:, None]
        changed = replace(turns_used, start=up[calibration.used], end=up[calibration.used + 1])
        misclosure_change = (
            propagate_gravity(changed, calibration.matrix, calibration.bias_change) - changed.end - misclosure
        )
        response = np.einsum("ptk,tk->p", calibration.response, misclosure_change)
        covariance += np.outer(response, response)
    return covariance
