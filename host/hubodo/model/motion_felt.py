"""What a node feels on a wheel or on the body: angular rate, its derivative, specific force."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import Geometry
from hubodo.model.inputs import Body, Earth
from hubodo.model.rolling import Rolling
from hubodo.vehicle import side_sign


def on_wheel(body: Body, rolling: Rolling, geometry: Geometry, facing: float) -> tuple[Array, Array, Array]:
    """Angular rate, its derivative and specific force in node axes, (3, N) each.

    Omega = theta' a + r z_b; f_s = C_sb (a_h + g z) + Omega' x rho + Omega x (Omega x rho).
    """
    side = side_sign(geometry.side or "left")
    lean, upright = side * np.sin(geometry.camber), np.cos(geometry.camber)
    cos, sin = np.cos(rolling.angle), np.sin(rolling.angle)
    r, r_slope = body.yaw_rate, body.yaw_acceleration
    rate, slope, force = (np.empty((3, len(r))) for _ in range(3))
    across, across_slope = upright * r, upright * r_slope
    turning = across * rolling.spin
    rate[0], rate[1] = across * cos, (-facing) * across * sin
    rate[2] = facing * (rolling.spin + lean * r)
    slope[0] = across_slope * cos - turning * sin
    slope[1] = -facing * (across_slope * sin + turning * cos)
    slope[2] = facing * (rolling.spin_acceleration + lean * r_slope)
    hub_y = 0.5 * side * geometry.track_width - side * geometry.radius * np.sin(geometry.camber)
    hub_y -= geometry.aside
    ahead = body.acceleration - r_slope * hub_y + STANDARD_GRAVITY * np.sin(geometry.grade)
    aside = r * (body.speed - r * hub_y)
    upwards = STANDARD_GRAVITY * np.cos(geometry.grade)
    up = upright * upwards - lean * aside
    force[0] = cos * up + sin * ahead
    force[1] = facing * (cos * ahead - sin * up)
    force[2] = facing * (upright * aside + lean * upwards)
    return rate, slope, force


def off_axle(rate: Array, slope: Array, arm: tuple[float, float, float]) -> Array:
    """What an arm of m off the axle adds, (3, N): Omega' x rho + Omega (Omega . rho) - rho Omega²."""
    x, y, z = arm
    along = x * rate[0] + y * rate[1] + z * rate[2]
    square = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
    return np.stack(
        [
            slope[1] * z - slope[2] * y + rate[0] * along - x * square,
            slope[2] * x - slope[0] * z + rate[1] * along - y * square,
            slope[0] * y - slope[1] * x + rate[2] * along - z * square,
        ]
    )


def on_body(
    body: Body, geometry: Geometry, attitude: tuple[float, float, float], earth: Earth | None
) -> tuple[Array, Array, Array]:
    """The same for a node fixed to the body at its origin, turned by `attitude`, rad, against its axes."""
    zero = np.zeros_like(body.speed)
    rate = np.stack([zero, zero, body.yaw_rate])
    slope = np.stack([zero, zero, body.yaw_acceleration])
    if earth is not None:
        turning, turning_slope = earth.rate(body.heading, body.yaw_rate)
        rate, slope = rate + turning, slope + turning_slope
    force = np.stack(
        [
            body.acceleration
            + body.yaw_acceleration * geometry.aside
            + STANDARD_GRAVITY * np.sin(geometry.grade),
            body.yaw_rate * (body.speed + body.yaw_rate * geometry.aside),
            zero + STANDARD_GRAVITY * np.cos(geometry.grade),
        ]
    )
    turn = Rotation.from_rotvec(attitude).as_matrix().T
    return turn @ rate, turn @ slope, turn @ force
