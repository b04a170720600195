"""Effects of the mounting of a node on the hub: misalignment and lever arm."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Effect, OdometryPrior, parameter
from hubodo.effects.sensor_chain import Geometry, SensorChain
from hubodo.effects.triad import multiply

_TWO_SPEEDS_ARM_ADVICE = "drive at two speeds: a lever arm grows with the square of the spin"
_TILT_PRIOR = OdometryPrior(
    0.03,
    1e-6,
    "two degrees for mounting by hand; random walk: none, fixed",
    "drive on: the wheel must turn many multiply",
)
_LEVER_ARM_PRIOR = OdometryPrior(
    0.1, 1e-6, "any position on the hub; random walk: none, fixed", "drive faster, or brake and accelerate"
)


@dataclass(frozen=True)
class NodeMisalignment(Effect):
    """The node is rotated against its nominal axes: a vector v is measured as R(x, y, z)ᵀ v.

    R is the matrix of the rotation vector (x, y, z).
    """

    name: ClassVar[str] = "node_misalignment"
    is_invertible: ClassVar[bool] = True
    meaning: ClassVar[str] = "the node is not mounted straight"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "gyro_nonorthogonality": "drive slowly: a misaligned node rotates its accelerometer too",
        "accel_nonorthogonality": "drive fast: a misaligned node shows spin in gx and gy",
        "wheel_camber": "turn both ways at speed: camber shows in gz",
    }
    x: float = parameter("rad", 0.02, max_plausible=0.4, odometry_prior=_TILT_PRIOR)
    y: float = parameter("rad", 0.02, max_plausible=0.4, flips_with_facing=True, odometry_prior=_TILT_PRIOR)
    z: float = parameter("rad", 0.02, max_plausible=0.4, flips_with_facing=True)

    @cached_property
    def rotation(self) -> Array:
        """Return the rotation matrix R(x, y, z), (3, 3)."""
        # Imported here, because the import takes 0.1 s and only simulated nodes need it.
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_rotvec([self.x, self.y, self.z]).as_matrix())

    def axle_rotation(self) -> float:
        angle = math.sqrt(self.x**2 + self.y**2 + self.z**2)
        sine = self.z / angle * math.sin(0.5 * angle) if angle > 0.0 else 0.0
        # The twist of a swing-twist decomposition, whichever of the two comes first.
        return 2.0 * math.atan2(sine, math.cos(0.5 * angle))

    def rotate_into_node(self, chain: SensorChain) -> None:
        node_from_nominal = self.rotation.T
        for name in ("rate", "rate_derivative", "force"):
            setattr(chain, name, node_from_nominal @ getattr(chain, name))

    def rotate_out_of_node(self, chain: SensorChain) -> None:
        for name in ("rate", "rate_derivative", "force"):
            setattr(chain, name, multiply(self.rotation, getattr(chain, name)))


@dataclass(frozen=True)
class LeverArm(Effect):
    """The sensing point is off the axle by a vector in the nominal node axes, not the misaligned ones."""

    name: ClassVar[str] = "lever_arm"
    meaning: ClassVar[str] = "the sensor is off the axle"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "accel_bias": _TWO_SPEEDS_ARM_ADVICE,
        "accel_scale_factor": _TWO_SPEEDS_ARM_ADVICE,
    }
    x: float = parameter("m", 0.01, max_plausible=0.5, odometry_prior=_LEVER_ARM_PRIOR)
    y: float = parameter(
        "m", 0.01, max_plausible=0.5, flips_with_facing=True, odometry_prior=_LEVER_ARM_PRIOR
    )
    z: float = parameter("m", 0.01, max_plausible=0.1, flips_with_facing=True)

    def describe(self) -> str:
        return f"the IMU sits {math.hypot(self.x, self.y):.2g} m off the hub"

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        x, y, z = geometry.lever_arm
        return replace(geometry, lever_arm=(x + self.x, y + self.y, z + self.z))
