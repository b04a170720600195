"""Check that no axis of gyro or accelerometer triad is reversed or interchanged."""

from __future__ import annotations

import itertools

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.turn_calibration import MIN_TURN_ANGLE, MIN_TURN_COUNT
from hubodo.sensors.imu.turns import Turns, turn_errors

_MAX_MEDIAN_ERROR = 0.1
"""rad; a turn of 90 degrees has this error with a scale error of 6 %, twice the largest of data sheets."""
_MIN_IMPROVEMENT = 3.0


def check_axis_signs(turns: Turns) -> None:
    """Raise CalibrationError if the turns show that axes are reversed or interchanged; the error names them.

    All 48 signed permutations of the gyros are tried. A record that none of them explains is accepted here.
    """
    usable = turns.select((turns.angle > MIN_TURN_ANGLE) & (turns.defect == ""))
    if len(usable.dt) < MIN_TURN_COUNT:
        return
    identity = np.eye(3)
    error = float(np.median(turn_errors(usable, identity)))
    if error < _MAX_MEDIAN_ERROR:
        return
    candidates = [
        np.diag(signs) @ identity[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    # The matrix maps true to measured rates, so it is the inverse of the permutation of the measured ones.
    errors = [float(np.median(turn_errors(usable, matrix.T))) for matrix in candidates]
    best = int(np.argmin(errors))
    if errors[best] * _MIN_IMPROVEMENT < error:
        raise CalibrationError(
            f"gyro and accelerometer disagree by {np.degrees(error):.0f} degrees per turn, and by "
            f"{np.degrees(errors[best]):.2g} if {_describe(candidates[best])}; correct the columns"
        )


def _describe(matrix: Array) -> str:
    """Describe a signed permutation of the gyros by the fewest changes of gyro or accelerometer axes."""
    order = np.abs(matrix).argmax(axis=1)
    if (order != np.arange(3)).any():
        columns = ", ".join(f"{'-' if matrix[k, j] < 0 else ''}g{'xyz'[j]}" for k, j in enumerate(order))
        return f"the gyro columns gx, gy, gz are in truth {columns}"
    signs = np.diag(matrix)
    # Reversed accelerometers S f go with reversed gyros det(S) S w, because a rate is a pseudovector; so two
    # reversed gyros may also be one or two reversed accelerometers.
    choices = [("gyro", signs)]
    if np.prod(signs) > 0:
        choices += [("accelerometer", signs), ("accelerometer", -signs)]
    names = [
        (sensor, [axis for axis, s in zip("xyz", each, strict=True) if s < 0]) for sensor, each in choices
    ]
    fewest = min(len(axes) for _, axes in names)
    return ", or ".join(
        f"{sensor} {' and '.join(axes)} {'is' if fewest == 1 else 'are'} reversed"
        for sensor, axes in names
        if len(axes) == fewest
    )
