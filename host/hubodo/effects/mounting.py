"""Effects of how the node sits on the hub: turned, and off the axle."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Chain, Effect, Estimate, Geometry, parameter
from hubodo.effects.triad import times

_SQUARE = "drive at two speeds: a lever arm grows with the square of the spin"
_TILT = Estimate(
    0.03,
    1e-6,
    "two degrees of a mounting by hand; walk: it is fixed",
    "drive on: the wheel must turn many times",
)
_ARM = Estimate(
    0.1, 1e-6, "a node anywhere on the hub; walk: it is fixed", "drive faster, or brake and accelerate"
)


@dataclass(frozen=True)
class NodeMisalignment(Effect):
    """The node is turned by a rotation vector against its nominal axes: a vector v reads R(x, y, z)ᵀ v."""

    name: ClassVar[str] = "node_misalignment"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the node is not mounted straight"
    alike: ClassVar[Mapping[str, str]] = {
        "gyro_nonorthogonality": "drive slowly: a turned node turns its accelerometer too",
        "accel_nonorthogonality": "drive fast: a turned node leaks spin into gx and gy",
        "wheel_camber": "turn both ways at speed: camber shows in gz",
    }
    x: float = parameter("rad", 0.02, estimate=_TILT)
    y: float = parameter("rad", 0.02, turned=True, estimate=_TILT)
    z: float = parameter("rad", 0.02, turned=True)

    @cached_property
    def rotation(self) -> Array:
        """R(x, y, z), (3, 3)."""
        # A tenth of a second of loading that only a simulated node needs.
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_rotvec([self.x, self.y, self.z]).as_matrix())

    def mount(self, chain: Chain) -> None:
        turned = self.rotation.T
        for name in ("rate", "rate_derivative", "force"):
            setattr(chain, name, turned @ getattr(chain, name))

    def unmount(self, chain: Chain) -> None:
        for name in ("rate", "rate_derivative", "force"):
            setattr(chain, name, times(self.rotation, getattr(chain, name)))


@dataclass(frozen=True)
class LeverArm(Effect):
    """From the axle to the sensing point, in node axes before `node_misalignment` turns them."""

    name: ClassVar[str] = "lever_arm"
    meaning: ClassVar[str] = "the sensor does not sit on the axle"
    alike: ClassVar[Mapping[str, str]] = {
        "accel_bias": _SQUARE,
        "accel_scale_factor": _SQUARE,
    }
    x: float = parameter("m", 0.01, estimate=_ARM)
    y: float = parameter("m", 0.01, turned=True, estimate=_ARM)
    z: float = parameter("m", 0.01, turned=True)

    def in_words(self) -> str:
        return f"the IMU sits {math.hypot(self.x, self.y):.2g} m off the hub"

    def shape(self, geometry: Geometry) -> Geometry:
        a, b, c = geometry.lever_arm
        return replace(geometry, lever_arm=(a + self.x, b + self.y, c + self.z))
