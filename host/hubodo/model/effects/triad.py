"""The cross-axis matrix of a triad, shared by gyro and accelerometer."""

from typing import Protocol

import numpy as np

from hubodo.model.frames import Array


class CrossAxis(Protocol):
    """Six small angles; δxz is how much of y the x axis reads, and so on."""

    @property
    def xz(self) -> float: ...
    @property
    def xy(self) -> float: ...
    @property
    def yz(self) -> float: ...
    @property
    def yx(self) -> float: ...
    @property
    def zy(self) -> float: ...
    @property
    def zx(self) -> float: ...


def cross_axis(angles: CrossAxis) -> Array:
    """N of Avrutov, (3, 3): rows [0, δxz, -δxy], [-δyz, 0, δyx], [δzy, -δzx, 0]."""
    return np.array(
        [[0.0, angles.xz, -angles.xy], [-angles.yz, 0.0, angles.yx], [angles.zy, -angles.zx, 0.0]]
    )
