"""True motion of a node on a wheel or on the body: angular rate, its derivative and specific force."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array, sin_cos
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.sensor_chain import Geometry
from hubodo.model.inputs import BodyMotion, EarthRotation
from hubodo.model.rolling import WheelRotation
from hubodo.vehicle import side_sign


def motion_on_wheel(
    body: BodyMotion, rolling: WheelRotation, geometry: Geometry, facing: float
) -> tuple[Array, Array, Array]:
    """Return angular rate, its derivative and specific force of a node on a wheel, (3, N) each in node axes.

    Omega = theta' a + r z_b and f_s = C_sb (a_h + g z) at the axle, with spin theta', axle direction a, yaw
    rate r, vertical z_b, hub acceleration a_h, gravity g along z, and rotation C_sb from the body to the
    node. `lever_arm_force` adds the force off the axle. facing: +1 where the z axis of the node points left,
    else -1.
    """
    side = side_sign(geometry.side or "left")
    lean, upright = side * np.sin(geometry.camber), np.cos(geometry.camber)
    sin, cos = sin_cos(rolling.angle)
    r, yaw_acceleration = body.yaw_rate, body.yaw_acceleration
    rate, rate_derivative, force = (np.empty((3, len(r))) for _ in range(3))
    horizontal, horizontal_derivative = upright * r, upright * yaw_acceleration
    turning = horizontal * rolling.spin
    rate[0], rate[1] = horizontal * cos, (-facing) * horizontal * sin
    rate[2] = facing * (rolling.spin + lean * r)
    rate_derivative[0] = horizontal_derivative * cos - turning * sin
    rate_derivative[1] = -facing * (horizontal_derivative * sin + turning * cos)
    rate_derivative[2] = facing * (rolling.spin_acceleration + lean * yaw_acceleration)
    hub_y = 0.5 * side * geometry.track_width - side * geometry.radius * np.sin(geometry.camber)
    hub_y -= geometry.reference_y
    forward = body.acceleration - yaw_acceleration * hub_y + STANDARD_GRAVITY * np.sin(geometry.grade)
    lateral = r * (body.speed - r * hub_y)
    vertical = STANDARD_GRAVITY * np.cos(geometry.grade)
    up = upright * vertical - lean * lateral
    force[0] = cos * up + sin * forward
    force[1] = facing * (cos * forward - sin * up)
    force[2] = facing * (upright * lateral + lean * vertical)
    return rate, rate_derivative, force


def lever_arm_force(rate: Array, rate_derivative: Array, arm: tuple[float, float, float]) -> Array:
    """Return the specific force that a lever arm rho in m adds, (3, N) m/s².

    Omega' x rho + Omega (Omega . rho) - rho Omega², with angular rate Omega.
    """
    x, y, z = arm
    along = x * rate[0] + y * rate[1] + z * rate[2]
    square = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
    return np.stack(
        [
            rate_derivative[1] * z - rate_derivative[2] * y + rate[0] * along - x * square,
            rate_derivative[2] * x - rate_derivative[0] * z + rate[1] * along - y * square,
            rate_derivative[0] * y - rate_derivative[1] * x + rate[2] * along - z * square,
        ]
    )


def motion_on_body(
    body: BodyMotion, geometry: Geometry, attitude: tuple[float, float, float], earth: EarthRotation | None
) -> tuple[Array, Array, Array]:
    """Return angular rate, its derivative and specific force of a node at the body origin, (3, N) each.

    attitude: rad, rotation vector of the node relative to the body axes.
    """
    zero = np.zeros_like(body.speed)
    rate = np.stack([zero, zero, body.yaw_rate])
    rate_derivative = np.stack([zero, zero, body.yaw_acceleration])
    if earth is not None:
        earth_rate, earth_rate_derivative = earth.rate_and_derivative(body.heading, body.yaw_rate)
        rate, rate_derivative = rate + earth_rate, rate_derivative + earth_rate_derivative
    force = np.stack(
        [
            body.acceleration
            + body.yaw_acceleration * geometry.reference_y
            + STANDARD_GRAVITY * np.sin(geometry.grade),
            body.yaw_rate * (body.speed + body.yaw_rate * geometry.reference_y),
            zero + STANDARD_GRAVITY * np.cos(geometry.grade),
        ]
    )
    node_from_body = Rotation.from_rotvec(attitude).as_matrix().T
    return node_from_body @ rate, node_from_body @ rate_derivative, node_from_body @ force
