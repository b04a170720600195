"""What gyro and accelerometer have alike: the cross-axis terms of a triad."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, Self

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Chain, Effect, parameter

Sensor = Literal["gyro", "accel"]
XYZ = ("x", "y", "z")


def times(matrix: Array, vectors: Array) -> Array:
    """matrix @ vectors, (3, N), as plain products and sums: the same bits for any N."""
    x, y, z = vectors
    return np.asarray(matrix[:, :1] * x + matrix[:, 1:2] * y + matrix[:, 2:] * z)


@dataclass(frozen=True)
class LinearEffect(Effect):
    """What is read beyond what there is, in proportion to it. sensor: which triad reads it."""

    undone: ClassVar[bool] = True
    sensor: ClassVar[Sensor]

    def matrix(self) -> Array:
        """(3, 3), to be added to the identity."""
        raise NotImplementedError

    def respond(self, chain: Chain) -> None:
        if self.sensor == "gyro":
            chain.gyro += self.matrix() @ chain.rate
        else:
            chain.accel += self.matrix() @ chain.force


@dataclass(frozen=True)
class CrossAxis(LinearEffect):
    """Six small angles after Avrutov, eq. 1; xz is how much of y the x axis reads, and so on."""

    places: ClassVar[Mapping[str, tuple[int, int, float]]] = {
        "xz": (0, 1, 1.0),
        "xy": (0, 2, -1.0),
        "yz": (1, 0, -1.0),
        "yx": (1, 2, 1.0),
        "zy": (2, 0, 1.0),
        "zx": (2, 1, -1.0),
    }
    """Row, column and sign of each angle: rows [0, δxz, -δxy], [-δyz, 0, δyx], [δzy, -δzx, 0]."""

    xz: float = parameter("rad", 0.01, turned=True)
    xy: float = parameter("rad", 0.01, turned=True)
    yz: float = parameter("rad", 0.01, turned=True)
    yx: float = parameter("rad", 0.01)
    zy: float = parameter("rad", 0.01, turned=True)
    zx: float = parameter("rad", 0.01)

    def matrix(self) -> Array:
        """N, (3, 3)."""
        made = np.zeros((3, 3))
        for name, (row, column, sign) in self.places.items():
            made[row, column] = sign * getattr(self, name)
        return made

    @classmethod
    def of_matrix(cls, matrix: Array) -> Self:
        """The angles in a matrix, (3, 3); its diagonal does not count."""
        return cls(**{name: sign * float(matrix[i, j]) for name, (i, j, sign) in cls.places.items()})


@dataclass(frozen=True)
class ScaleFactor(LinearEffect):
    """(1 + e) times what is there, each axis its own e."""

    x: float = parameter("1", 0.01)
    y: float = parameter("1", 0.01)
    z: float = parameter("1", 0.01)

    def matrix(self) -> Array:
        """diag(e), (3, 3)."""
        return np.diag([self.x, self.y, self.z])
