"""What gyro and accelerometer have alike: the cross-axis terms of a triad."""

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Effect, parameter


@dataclass(frozen=True)
class CrossAxis(Effect):
    """Six small angles after Avrutov; xz is how much of y the x axis reads, and so on."""

    xz: float = parameter("rad", 0.01, turned=True)
    xy: float = parameter("rad", 0.01, turned=True)
    yz: float = parameter("rad", 0.01, turned=True)
    yx: float = parameter("rad", 0.01)
    zy: float = parameter("rad", 0.01, turned=True)
    zx: float = parameter("rad", 0.01)

    def matrix(self) -> Array:
        """N, (3, 3): rows [0, δxz, -δxy], [-δyz, 0, δyx], [δzy, -δzx, 0]."""
        return np.array([[0.0, self.xz, -self.xy], [-self.yz, 0.0, self.yx], [self.zy, -self.zx, 0.0]])


@dataclass(frozen=True)
class ScaleFactor(Effect):
    """(1 + e) times what is there, each axis its own e."""

    x: float = parameter("1", 0.01)
    y: float = parameter("1", 0.01)
    z: float = parameter("1", 0.01)

    def more(self, there: Array) -> Array:
        """(3, N), what is read beyond what is there."""
        return np.array([[self.x], [self.y], [self.z]]) * there
