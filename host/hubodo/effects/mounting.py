"""Effects of how the node sits on the hub: turned, and off the axle."""

from dataclasses import dataclass, replace
from typing import ClassVar

from scipy.spatial.transform import Rotation

from hubodo.effects.base import Chain, Effect, Estimate, Geometry, parameter

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
    x: float = parameter("rad", 0.02, estimate=_TILT)
    y: float = parameter("rad", 0.02, turned=True, estimate=_TILT)
    z: float = parameter("rad", 0.02, turned=True)

    def mount(self, chain: Chain) -> None:
        turned = Rotation.from_rotvec([self.x, self.y, self.z]).as_matrix().T
        for name in ("rate", "rate_derivative", "force"):
            setattr(chain, name, turned @ getattr(chain, name))


@dataclass(frozen=True)
class LeverArm(Effect):
    """From the axle to the sensing point, in node axes before `node_misalignment` turns them."""

    name: ClassVar[str] = "lever_arm"
    x: float = parameter("m", 0.01, estimate=_ARM)
    y: float = parameter("m", 0.01, turned=True, estimate=_ARM)
    z: float = parameter("m", 0.01, turned=True)

    def shape(self, geometry: Geometry) -> Geometry:
        a, b, c = geometry.lever_arm
        return replace(geometry, lever_arm=(a + self.x, b + self.y, c + self.z))
