"""Effects of how the node sits on the hub: turned, and off the axle."""

from dataclasses import dataclass, replace
from typing import ClassVar

from scipy.spatial.transform import Rotation

from hubodo.effects.base import Chain, Effect, Geometry, parameter


@dataclass(frozen=True)
class NodeMisalignment(Effect):
    """The node is turned by a rotation vector against its nominal axes: a vector v reads R(x, y, z)ᵀ v."""

    name: ClassVar[str] = "node_misalignment"
    x: float = parameter("rad", 0.02)
    y: float = parameter("rad", 0.02)
    z: float = parameter("rad", 0.02)

    def mount(self, chain: Chain) -> None:
        turned = Rotation.from_rotvec([self.x, self.y, self.z]).as_matrix().T
        for name in ("rate", "rate_derivative", "force"):
            setattr(chain, name, turned @ getattr(chain, name))


@dataclass(frozen=True)
class LeverArm(Effect):
    """From the axle to the sensing point, in node axes before `node_misalignment` turns them."""

    name: ClassVar[str] = "lever_arm"
    x: float = parameter("m", 0.01)
    y: float = parameter("m", 0.01)
    z: float = parameter("m", 0.01)

    def shape(self, geometry: Geometry) -> Geometry:
        a, b, c = geometry.lever_arm
        return replace(geometry, lever_arm=(a + self.x, b + self.y, c + self.z))
