"""Effects of the accelerometer triad: offset, scale, cross-axis, limits."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.effects.base import Chain, Effect, Estimate, Shows, parameter
from hubodo.effects.triad import CrossAxis, ScaleFactor, Sensor

_OFFSET = "zero-g tolerance of the MPU-6050, 50 mg"
_ACROSS = Estimate(0.4, 1e-3, f"{_OFFSET}; walk: vibration and temperature, 6 mg in an hour")
_ALONG = Estimate(0.4, 1e-2, f"{_OFFSET}; walk: ten times that across, for the banking of roads")
_LEAK = Estimate(
    0.03,
    1e-6,
    "cross-axis sensitivity of the MPU-6050, 2 %, and a board not square in its case; walk: it is fixed",
)


@dataclass(frozen=True)
class AccelBias(Effect):
    """A constant offset."""

    name: ClassVar[str] = "accel_bias"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the accelerometer reads an offset"
    x: float = parameter("m/s²", 0.1, estimate=_ACROSS)
    y: float = parameter("m/s²", 0.1, turned=True, estimate=_ACROSS)
    z: float = parameter("m/s²", 0.1, turned=True, estimate=_ALONG)

    def offset(self, chain: Chain) -> None:
        chain.accel += np.array([[self.x], [self.y], [self.z]])


@dataclass(frozen=True)
class AccelScaleFactor(ScaleFactor):
    """Reads (1 + e) times the specific force, each axis its own e."""

    name: ClassVar[str] = "accel_scale_factor"
    sensor: ClassVar[Sensor] = "accel"
    meaning: ClassVar[str] = "the accelerometer reads too much or too little, in proportion"
    alike: ClassVar[Mapping[str, str]] = {
        "accel_nonorthogonality": "accelerate and turn hard, both ways",
    }


@dataclass(frozen=True)
class AccelNonorthogonality(CrossAxis):
    """Cross-axis terms of the accelerometer after Avrutov."""

    name: ClassVar[str] = "accel_nonorthogonality"
    sensor: ClassVar[Sensor] = "accel"
    meaning: ClassVar[str] = "the axes of the accelerometer are not square"
    zy: float = parameter("rad", 0.01, turned=True, estimate=_LEAK)
    zx: float = parameter("rad", 0.01, estimate=_LEAK)


@dataclass(frozen=True)
class AccelSaturation(Effect):
    """Nothing beyond ± limit is read; without a limit (infinity) everything is."""

    name: ClassVar[str] = "accel_saturation"
    shows: ClassVar[Shows] = "scatter"
    meaning: ClassVar[str] = "the accelerometer cannot read forces beyond a limit"
    limit: float = parameter("m/s²", 30.0, positive=True, default=math.inf)

    def clip(self, chain: Chain) -> None:
        np.clip(chain.accel, -self.limit, self.limit, out=chain.accel)
