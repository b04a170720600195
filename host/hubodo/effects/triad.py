"""Linear errors of a sensor triad: scale factors and cross-axis terms of gyro and accelerometer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Effect, parameter
from hubodo.effects.sensor_chain import SensorChain

Sensor = Literal["gyro", "accel"]
XYZ = ("x", "y", "z")


def multiply(matrix: Array, vectors: Array) -> Array:
    """Return matrix @ vectors, (3, N), by elementwise products and sums: bit-identical for any N."""
    x, y, z = vectors
    return np.asarray(matrix[:, :1] * x + matrix[:, 1:2] * y + matrix[:, 2:] * z)


@dataclass(frozen=True)
class LinearEffect(Effect):
    """An error that is a linear function of the measured vector; `sensor` names the triad."""

    is_invertible: ClassVar[bool] = True
    sensor: ClassVar[Sensor]

    def matrix(self) -> Array:
        """Return the (3, 3) error matrix: the triad measures (I + matrix) times the true vector."""
        raise NotImplementedError

    def add_scale_errors(self, chain: SensorChain) -> None:
        if self.sensor == "gyro":
            chain.gyro += self.matrix() @ chain.rate
        else:
            chain.accel += self.matrix() @ chain.force


@dataclass(frozen=True)
class CrossAxis(LinearEffect):
    """Six small cross-axis angles, after Avrutov, eq. 1: the reading of x gains xz times y, and so on."""

    matrix_entries: ClassVar[Mapping[str, tuple[int, int, float]]] = {
        "xz": (0, 1, 1.0),
        "xy": (0, 2, -1.0),
        "yz": (1, 0, -1.0),
        "yx": (1, 2, 1.0),
        "zy": (2, 0, 1.0),
        "zx": (2, 1, -1.0),
    }
    """Row, column and sign of each angle in the matrix [0, δxz, -δxy], [-δyz, 0, δyx], [δzy, -δzx, 0]."""

    xz: float = parameter("rad", 0.01, max_plausible=0.15, flips_with_facing=True)
    xy: float = parameter("rad", 0.01, max_plausible=0.15, flips_with_facing=True)
    yz: float = parameter("rad", 0.01, max_plausible=0.15, flips_with_facing=True)
    yx: float = parameter("rad", 0.01, max_plausible=0.15)
    zy: float = parameter("rad", 0.01, max_plausible=0.15, flips_with_facing=True)
    zx: float = parameter("rad", 0.01, max_plausible=0.15)

    def matrix(self) -> Array:
        """Return the (3, 3) matrix of the angles, with a zero diagonal."""
        matrix = np.zeros((3, 3))
        for name, (row, column, sign) in self.matrix_entries.items():
            matrix[row, column] = sign * getattr(self, name)
        return matrix

    @classmethod
    def of_matrix(cls, matrix: Array) -> Self:
        """Return the angles in a (3, 3) matrix; its diagonal is ignored."""
        return cls(**{name: sign * float(matrix[i, j]) for name, (i, j, sign) in cls.matrix_entries.items()})


@dataclass(frozen=True)
class ScaleFactor(LinearEffect):
    """Each axis reads (1 + e) times the true value, with its own scale error e."""

    x: float = parameter("1", 0.01, max_plausible=0.15)
    y: float = parameter("1", 0.01, max_plausible=0.15)
    z: float = parameter("1", 0.01, max_plausible=0.15)

    def matrix(self) -> Array:
        """Return diag(e), (3, 3)."""
        return np.diag([self.x, self.y, self.z])
