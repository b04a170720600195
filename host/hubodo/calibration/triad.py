"""Error model of a sensor triad, from true to raw values, and its inverse.

    raw  = (I + diag(e) + N) true + b
    true = (I + diag(e) + N)^-1 (raw - b)

b is the bias, e the scale errors, N the nonorthogonality after Avrutov, eq. 1 (stages 3 and 4 of the sensor
chain): row x [0, d_xz, -d_xy], row y [-d_yz, 0, d_yx], row z [d_zy, -d_zx, 0]; d_xz is the angle, rad, by
which the sensor on x is rotated about z.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.calibration.file import CalibratedEffect, Quantity, build_effects
from hubodo.effects import Effect
from hubodo.effects.triad import XYZ, CrossAxis, LinearEffect, Sensor


@dataclass(frozen=True)
class Triad:
    """Errors of three orthogonal sensors of one kind.

    Attributes
    ----------
    bias : (3,) in the unit of the sensor.
    matrix : (3, 3) M = I + diag(e) + N.
    """

    bias: Array = field(default_factory=lambda: np.zeros(3))
    matrix: Array = field(default_factory=lambda: np.eye(3))

    def correct(self, raw: Array, extra_bias: Array | float = 0.0) -> Array:
        """Return true values from raw ones, (N, 3) or (3,).

        extra_bias: (3,) or (N, 3), bias that depends on time or temperature, subtracted too.
        """
        return np.asarray(
            np.linalg.solve(self.matrix, np.atleast_2d(raw - self.bias - extra_bias).T).T
        ).reshape(np.shape(raw))

    @property
    def scale_error(self) -> Array:
        """Return the scale errors e, (3,); a sensor with 0.01 reads one per cent too much."""
        return np.diag(self.matrix) - 1.0

    @property
    def nonorthogonality(self) -> Mapping[str, float]:
        """Return the six nonorthogonality angles d by name, rad."""
        return CrossAxis.of_matrix(self.matrix).values()


def triad_matrix(effects: Iterable[Effect], sensor: Sensor) -> Array:
    """Return I + diag(e) + N, (3, 3), of the effects of one triad."""
    linear = [it.matrix() for it in effects if isinstance(it, LinearEffect) and it.sensor == sensor]
    return np.asarray(np.eye(3) + sum(linear))


def triad_from_effects(effects: Mapping[str, CalibratedEffect], sensor: Sensor) -> Triad:
    """Return the triad of a node's calibration; effects that it lacks count as zero."""
    bias = effects.get(f"{sensor}_bias", CalibratedEffect({}))
    return Triad(np.array([bias.value(axis) for axis in XYZ]), triad_matrix(build_effects(effects), sensor))


def effects_from_triad(
    triad: Triad, sigma: Array, sensor: Sensor, observable: NDArray[np.bool_] | None = None
) -> dict[str, Mapping[str, Quantity]]:
    """Return the parameters of a triad by effect name, for the calibration file.

    sigma: (12,) 1 sigma of b, then of M row by row. observable: (12,) True for each of these values that was
    determined; all by default.
    """
    is_observable = np.ones(12, bool) if observable is None else observable
    matrix_sigma, angles = sigma[3:].reshape(3, 3), triad.nonorthogonality
    in_matrix = is_observable[3:].reshape(3, 3)
    effects = {
        f"{sensor}_bias": {
            a: Quantity(float(triad.bias[i]), float(sigma[i])) for i, a in enumerate(XYZ) if is_observable[i]
        },
        f"{sensor}_scale_factor": {
            a: Quantity(float(triad.scale_error[i]), float(matrix_sigma[i, i]))
            for i, a in enumerate(XYZ)
            if in_matrix[i, i]
        },
        f"{sensor}_nonorthogonality": {
            name: Quantity(angles[name], float(matrix_sigma[i, j]))
            for name, (i, j, _) in CrossAxis.matrix_entries.items()
            if in_matrix[i, j]
        },
    }
    return {effect: parameters for effect, parameters in effects.items() if parameters}
