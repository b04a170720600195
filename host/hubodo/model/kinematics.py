"""What a node on a rolling wheel feels: angular rate and specific force from the motion of the vehicle."""

from dataclasses import dataclass

import numpy as np

from hubodo.model.frames import (
    STANDARD_GRAVITY,
    Array,
    Facing,
    Side,
    facing_sign,
    node_from_body,
    side_sign,
)


@dataclass(frozen=True, slots=True)
class WheelMount:
    """One node on one wheel.

    radius, track_width: m. camber: rad, tops inwards positive. lever_arm: m, from the axle to the sensing
    point in node axes.
    """

    side: Side
    facing: Facing
    radius: float
    track_width: float
    camber: float = 0.0
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def contact_y(self) -> float:
        """y of the wheel's contact in the body, m."""
        return 0.5 * side_sign(self.side) * self.track_width

    @property
    def hub_y(self) -> float:
        """y of the hub in the body, m: camber brings it towards the middle."""
        return float(self.contact_y - side_sign(self.side) * self.radius * np.sin(self.camber))

    def node_from_body(self, theta: Array) -> Array:
        """Rotations C_sb, (N, 3, 3), at wheel angles theta, (N,) rad."""
        return node_from_body(theta, self.side, self.facing, self.camber)


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """Motion of the body origin at N times, each (N,): m/s, m/s², rad/s, rad/s²."""

    speed: Array
    acceleration: Array
    yaw_rate: Array
    yaw_acceleration: Array


@dataclass(frozen=True, slots=True)
class NodeMotion:
    """True motion in node axes: angular_rate (N, 3) rad/s, specific_force (N, 3) m/s²."""

    angular_rate: Array
    specific_force: Array


def wheel_rate(body: BodyMotion, mount: WheelMount) -> tuple[Array, Array]:
    """Rate (N,) rad/s and acceleration (N,) rad/s² of the wheel angle, rolling without slip.

    theta' = (v - r y_w) / R, with or without camber.
    """
    rate = (body.speed - body.yaw_rate * mount.contact_y) / mount.radius
    acceleration = (body.acceleration - body.yaw_acceleration * mount.contact_y) / mount.radius
    return rate, acceleration


def wheel_node_motion(body: BodyMotion, mount: WheelMount, theta: Array, grade: float = 0.0) -> NodeMotion:
    """Angular rate and specific force of a node on a wheel.

    theta: (N,) rad, the wheel angle. grade: rad, positive where the road climbs.
    Omega = theta' a + r z_b; f_s = C_sb a_h + Omega'_s x rho + Omega_s x (Omega_s x rho) + g C_sb z, with
    Omega'_s the plain time derivative of the components of Omega in node axes.
    """
    spin, spin_acceleration = wheel_rate(body, mount)
    sign = facing_sign(mount.facing)
    lean = side_sign(mount.side) * np.sin(mount.camber)
    upright = np.cos(mount.camber)
    cos, sin = np.cos(theta), np.sin(theta)
    yaw, yaw_acceleration = body.yaw_rate, body.yaw_acceleration

    rate = np.stack([upright * yaw * cos, -sign * upright * yaw * sin, sign * (spin + lean * yaw)], axis=1)
    rate_derivative = np.stack(
        [
            upright * (yaw_acceleration * cos - yaw * spin * sin),
            -sign * upright * (yaw_acceleration * sin + yaw * spin * cos),
            sign * (spin_acceleration + lean * yaw_acceleration),
        ],
        axis=1,
    )
    hub_acceleration = np.stack(
        [
            body.acceleration - yaw_acceleration * mount.hub_y,
            yaw * (body.speed - yaw * mount.hub_y),
            np.zeros_like(yaw),
        ],
        axis=1,
    )
    up = STANDARD_GRAVITY * np.array([np.sin(grade), 0.0, np.cos(grade)])
    rotation = mount.node_from_body(theta)
    arm = np.asarray(mount.lever_arm)
    force = (
        np.einsum("nij,nj->ni", rotation, hub_acceleration + up)
        + np.cross(rate_derivative, arm)
        + np.cross(rate, np.cross(rate, arm))
    )
    return NodeMotion(rate, force)


def body_node_motion(body: BodyMotion, grade: float = 0.0) -> NodeMotion:
    """The same for a node on the vehicle's frame, at the body origin with body axes."""
    zero = np.zeros_like(body.speed)
    rate = np.stack([zero, zero, body.yaw_rate], axis=1)
    force = np.stack(
        [
            body.acceleration + STANDARD_GRAVITY * np.sin(grade),
            body.yaw_rate * body.speed,
            zero + STANDARD_GRAVITY * np.cos(grade),
        ],
        axis=1,
    )
    return NodeMotion(rate, force)
