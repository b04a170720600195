"""A drive as the chips on its wheels feel it: the forward model behind the `Motion` a virtual node asks."""

from dataclasses import dataclass

import numpy as np

from hubodo.model.drive import Drive
from hubodo.model.frames import Array
from hubodo.model.kinematics import WheelMount, wheel_node_motion

# Earth's field where the demo drives: horizontal part northwards (x at the start), the rest down.
_EARTH_FIELD = np.array([20e-6, 0.0, -44e-6])


@dataclass(frozen=True)
class WheelMotion:
    """Motion of one node on a wheel of a vehicle that makes a drive.

    start: s of chip time at which the drive begins; before it the vehicle rests. start_angle: rad.
    """

    drive: Drive
    mount: WheelMount
    start: float = 0.0
    start_angle: float = 0.0
    temperature_c: float = 25.0

    @property
    def duration(self) -> float:
        return self.start + self.drive.duration

    def angular_rate(self, t: Array) -> Array:
        """(n, 3) rad/s."""
        at = t - self.start
        body = self.drive.body(at)
        theta = self.drive.wheel_angle(at, self.mount, self.start_angle)
        return wheel_node_motion(body, self.mount, theta).angular_rate

    def specific_force(self, t: Array) -> Array:
        """(n, 3) m/s²."""
        at = t - self.start
        body = self.drive.body(at)
        theta = self.drive.wheel_angle(at, self.mount, self.start_angle)
        return wheel_node_motion(body, self.mount, theta).specific_force

    def temperature(self, t: Array) -> Array:
        """(n,) °C."""
        return np.full(len(t), self.temperature_c)

    def magnetic_field(self, t: Array) -> Array:
        """(n, 3) T: the Earth's field, turned with the vehicle and the wheel."""
        at = t - self.start
        heading = self.drive.heading(at)
        cos, sin = np.cos(heading), np.sin(heading)
        x, y, z = _EARTH_FIELD
        body = np.stack([cos * x + sin * y, -sin * x + cos * y, np.full(len(t), z)], axis=1)
        theta = self.drive.wheel_angle(at, self.mount, self.start_angle)
        rotation = self.mount.node_from_body(theta)
        return np.asarray(np.einsum("nij,nj->ni", rotation, body))
