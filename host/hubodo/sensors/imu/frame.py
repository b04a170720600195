"""What the errors of the accelerometers' calibration do to gyros that were calibrated against gravity.

The turns between rests are judged by gravity as the accelerometers show it. An angle or scale by which their
calibration is off bends all turns alike, so that no scatter among the turns tells of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.sensors.imu.rests import Rests
from hubodo.sensors.imu.scalar_calibration import ScalarCalibration
from hubodo.sensors.imu.turns import TurnCalibration, Turns, carried


def frame_covariance(found: TurnCalibration, turns: Turns, rests: Rests, accel: ScalarCalibration) -> Array:
    """(12, 12) of the gyros' bias and of M row by row, to be added to that of the turns.

    turns: all between the rests. To first order, one principal direction of the accelerometers' covariance
    after the other.
    """
    used = turns.select(found.used)
    miss = carried(used, found.matrix, found.bias_change) - used.end
    values, vectors = np.linalg.eigh(accel.full_covariance)
    made = np.zeros((12, 12))
    for moved in (vectors * np.sqrt(np.maximum(values, 0.0))).T:
        triad = Triad(accel.triad.bias + moved[:3], accel.triad.matrix + moved[3:].reshape(3, 3))
        up = np.asarray(triad.apply(rests.accel))
        up /= np.linalg.norm(up, axis=1)[:, None]
        other = replace(used, start=up[found.used], end=up[found.used + 1])
        change = carried(other, found.matrix, found.bias_change) - other.end - miss
        answer = np.einsum("ptk,tk->p", found.response, change)
        made += np.outer(answer, answer)
    return made
