"""The error model of one triad and its one formula, both ways: raw from true and true from raw.

    raw  = (I + diag(e) + N) true + b
    true = (I + diag(e) + N)^-1 (raw - b)

in this order: the bias comes off first, then the inverse matrix is applied from the left. N after Avrutov,
eq. 1 (stages 3 and 4 of the sensor chain): row x [0, d_xz, -d_xy], row y [-d_yz, 0, d_yx], row z [d_zy,
-d_zx, 0]; d_xz is the angle, rad, by which the sensor on x is turned about z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.file import NONORTHOGONALITY, XYZ, CalibratedEffect, Quantity

Array = NDArray[np.float64]

_PLACES = {"xz": (0, 1, 1.0), "xy": (0, 2, -1.0), "yz": (1, 0, -1.0), "yx": (1, 2, 1.0), "zy": (2, 0, 1.0),
           "zx": (2, 1, -1.0)}  # fmt: skip


@dataclass(frozen=True)
class Triad:
    """Errors of three like sensors.

    bias: (3,) in the unit of the sensor. matrix: (3, 3) M = I + diag(e) + N.
    """

    bias: Array = field(default_factory=lambda: np.zeros(3))
    matrix: Array = field(default_factory=lambda: np.eye(3))

    def apply(self, raw: Array, extra_bias: Array | float = 0.0) -> Array:
        """True values from raw ones, (N, 3) or (3,). extra_bias: what time or temperature adds to the
        bias."""
        return np.asarray(
            np.linalg.solve(self.matrix, np.atleast_2d(raw - self.bias - extra_bias).T).T
        ).reshape(np.shape(raw))

    def unapply(self, true: Array, extra_bias: Array | float = 0.0) -> Array:
        """What the sensor shows for true values, (N, 3) or (3,): the reverse of `apply`."""
        return np.asarray(true @ self.matrix.T + self.bias + extra_bias)

    @property
    def scale_error(self) -> Array:
        """(3,) e; 0.01 reads one per cent too much."""
        return np.diag(self.matrix) - 1.0

    @property
    def nonorthogonality(self) -> Mapping[str, float]:
        """The six angles d by name, rad."""
        return {name: sign * float(self.matrix[i, j]) for name, (i, j, sign) in _PLACES.items()}

    @property
    def differences(self) -> Array:
        """(3,) d_xz - d_yz, d_zy - d_xy, d_yx - d_zx: what the scalar method alone can see."""
        m = self.matrix
        return np.array([m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]])


def triad_from(bias: Array, scale_error: Array, nonorthogonality: Mapping[str, float]) -> Triad:
    """Triad from b, e and the six angles by name; angles not given are zero."""
    matrix = np.eye(3) + np.diag(scale_error)
    for name, angle in nonorthogonality.items():
        i, j, sign = _PLACES[name]
        matrix[i, j] += sign * angle
    return Triad(np.array(bias, float), matrix)


def triad_from_effects(effects: Mapping[str, CalibratedEffect], kind: str) -> Triad:
    """Triad of `kind` "gyro" or "accel" from a node's calibration; what is not in it counts as zero."""
    empty = CalibratedEffect({})
    bias, scale, angles = (
        effects.get(f"{kind}_{name}", empty) for name in ("bias", "scale_factor", "nonorthogonality")
    )
    return triad_from(
        np.array([bias.value(axis) for axis in XYZ]),
        np.array([scale.value(axis) for axis in XYZ]),
        {name: angles.value(name) for name in NONORTHOGONALITY},
    )


def effects_from_triad(triad: Triad, sigma: Array, kind: str) -> dict[str, Mapping[str, Quantity]]:
    """Effect name -> parameters for the calibration file.

    sigma: (12,) of b, then of M row by row; kind: "gyro" or "accel".
    """
    spread = sigma[3:].reshape(3, 3)
    angles = triad.nonorthogonality
    return {
        f"{kind}_bias": {a: Quantity(float(triad.bias[i]), float(sigma[i])) for i, a in enumerate(XYZ)},
        f"{kind}_scale_factor": {
            a: Quantity(float(triad.scale_error[i]), float(spread[i, i])) for i, a in enumerate(XYZ)
        },
        f"{kind}_nonorthogonality": {
            name: Quantity(angles[name], float(spread[i, j])) for name, (i, j, _) in _PLACES.items()
        },
    }
