"""Frames of a wheel node: hub axes with camber, and the rotation from the body to the node."""

import numpy as np

from hubodo.arrays import Array, sin_cos
from hubodo.vehicle import Facing, Side, facing_sign, side_sign


def hub_axes(side: Side, camber: float) -> tuple[Array, Array, Array]:
    """Return the hub axes of a wheel, up u, forward f and axle to the left a, (3,) each in body axes.

    camber: rad, positive when the wheel tops lean inwards.
    """
    s = side_sign(side) * np.sin(camber)
    c = np.cos(camber)
    return np.array([0.0, -s, c]), np.array([1.0, 0.0, 0.0]), np.array([0.0, c, s])


def node_from_body(theta: Array, side: Side, facing: Facing, camber: float = 0.0) -> Array:
    """Return the rotations C_sb, (N, 3, 3), from body components to node components.

    theta: (N,) rad, wheel angle, growing when rolling forwards.
    x_s = cos(theta) u + sin(theta) f, y_s = cos(theta) f - sin(theta) u, z_s = a; a node facing right has
    y_s and z_s negated.
    """
    u, f, a = hub_axes(side, camber)
    sin, cos = (part[:, None] for part in sin_cos(theta))
    sign = facing_sign(facing)
    rows = [cos * u + sin * f, sign * (cos * f - sin * u), np.broadcast_to(sign * a, (len(theta), 3))]
    return np.stack(rows, axis=1)
