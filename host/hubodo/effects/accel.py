"""Effects of the accelerometer triad: bias, scale, cross-axis and range."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.effects.base import Effect, OdometryPrior, Visibility, parameter
from hubodo.effects.sensor_chain import SensorChain
from hubodo.effects.triad import CrossAxis, ScaleFactor, Sensor

_ZERO_G_ORIGIN = "zero-g tolerance of the MPU-6050, 50 mg"
_ACCEL_BIAS_ACROSS_PRIOR = OdometryPrior(
    0.4, 1e-3, f"{_ZERO_G_ORIGIN}; random walk: vibration and temperature, 6 mg in an hour"
)
_ACCEL_BIAS_ALONG_PRIOR = OdometryPrior(
    0.4, 1e-2, f"{_ZERO_G_ORIGIN}; random walk: ten times that across the axle, for banked roads"
)
_CROSS_AXIS_PRIOR = OdometryPrior(
    0.03,
    1e-6,
    "cross-axis sensitivity of the MPU-6050, 2 %, and a board tilted in its case; random walk: none, fixed",
)


@dataclass(frozen=True)
class AccelBias(Effect):
    """The accelerometer has a constant bias."""

    name: ClassVar[str] = "accel_bias"
    varies_between_drives: ClassVar[bool] = True
    is_invertible: ClassVar[bool] = True
    meaning: ClassVar[str] = "the accelerometer reads an offset"
    x: float = parameter("m/s²", 0.1, max_plausible=5.0, odometry_prior=_ACCEL_BIAS_ACROSS_PRIOR)
    y: float = parameter(
        "m/s²", 0.1, max_plausible=5.0, flips_with_facing=True, odometry_prior=_ACCEL_BIAS_ACROSS_PRIOR
    )
    z: float = parameter(
        "m/s²", 0.1, max_plausible=5.0, flips_with_facing=True, odometry_prior=_ACCEL_BIAS_ALONG_PRIOR
    )

    def add_offsets(self, chain: SensorChain) -> None:
        chain.accel += np.array([[self.x], [self.y], [self.z]])


@dataclass(frozen=True)
class AccelScaleFactor(ScaleFactor):
    """Each accelerometer axis reads (1 + e) times the specific force, with its own scale error e."""

    name: ClassVar[str] = "accel_scale_factor"
    sensor: ClassVar[Sensor] = "accel"
    meaning: ClassVar[str] = "the accelerometer has a scale error"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "accel_nonorthogonality": "accelerate and turn hard, both ways",
    }


@dataclass(frozen=True)
class AccelNonorthogonality(CrossAxis):
    """The accelerometer axes are not orthogonal: six cross-axis terms after Avrutov."""

    name: ClassVar[str] = "accel_nonorthogonality"
    sensor: ClassVar[Sensor] = "accel"
    meaning: ClassVar[str] = "the axes of the accelerometer are not orthogonal"
    zy: float = parameter(
        "rad", 0.01, max_plausible=0.15, flips_with_facing=True, odometry_prior=_CROSS_AXIS_PRIOR
    )
    zx: float = parameter("rad", 0.01, max_plausible=0.15, odometry_prior=_CROSS_AXIS_PRIOR)


@dataclass(frozen=True)
class AccelSaturation(Effect):
    """Accelerometer readings are clipped at ± limit; an infinite limit clips nothing."""

    name: ClassVar[str] = "accel_saturation"
    visible_in: ClassVar[Visibility] = "scatter"
    meaning: ClassVar[str] = "the accelerometer saturates"
    limit: float = parameter("m/s²", 30.0, positive=True, default=math.inf)

    def clip_readings(self, chain: SensorChain) -> None:
        np.clip(chain.accel, -self.limit, self.limit, out=chain.accel)
