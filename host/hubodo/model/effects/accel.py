"""Effects of the accelerometer triad: offset, scale, cross-axis, limits."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.model.effects.base import Chain, Effect, Shows, parameter
from hubodo.model.effects.triad import cross_axis


@dataclass(frozen=True)
class AccelBias(Effect):
    """A constant offset."""

    name: ClassVar[str] = "accel_bias"
    x: float = parameter("m/s²", 0.1)
    y: float = parameter("m/s²", 0.1)
    z: float = parameter("m/s²", 0.1)

    def offset(self, chain: Chain) -> None:
        chain.accel += np.array([[self.x], [self.y], [self.z]])


@dataclass(frozen=True)
class AccelScaleFactor(Effect):
    """Reads (1 + e) times the specific force, each axis its own e."""

    name: ClassVar[str] = "accel_scale_factor"
    x: float = parameter("1", 0.01)
    y: float = parameter("1", 0.01)
    z: float = parameter("1", 0.01)

    def respond(self, chain: Chain) -> None:
        chain.accel += np.array([[self.x], [self.y], [self.z]]) * chain.force


@dataclass(frozen=True)
class AccelNonorthogonality(Effect):
    """Cross-axis terms of the accelerometer after Avrutov."""

    name: ClassVar[str] = "accel_nonorthogonality"
    xz: float = parameter("rad", 0.01)
    xy: float = parameter("rad", 0.01)
    yz: float = parameter("rad", 0.01)
    yx: float = parameter("rad", 0.01)
    zy: float = parameter("rad", 0.01)
    zx: float = parameter("rad", 0.01)

    def respond(self, chain: Chain) -> None:
        chain.accel += cross_axis(self) @ chain.force


@dataclass(frozen=True)
class AccelSaturation(Effect):
    """Nothing beyond ± limit is read; without a limit (infinity) everything is."""

    name: ClassVar[str] = "accel_saturation"
    shows: ClassVar[Shows] = "scatter"
    limit: float = parameter("m/s²", 30.0, positive=True, default=math.inf)

    def clip(self, chain: Chain) -> None:
        np.clip(chain.accel, -self.limit, self.limit, out=chain.accel)
