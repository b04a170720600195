"""Rolling of a wheel: angle, spin and spin acceleration from the motion of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array, sin_cos
from hubodo.effects.sensor_chain import Geometry
from hubodo.model.inputs import BodyMotion
from hubodo.vehicle import side_sign


@dataclass(frozen=True, slots=True)
class WheelRotation:
    """Rotation of a wheel: angle in rad, spin in rad/s and spin_acceleration in rad/s², (N,) each."""

    angle: Array
    spin: Array
    spin_acceleration: Array

    def select(self, samples: slice) -> WheelRotation:
        """Return the rotation at a slice of the times."""
        return WheelRotation(self.angle[samples], self.spin[samples], self.spin_acceleration[samples])


def wheel_rotation(
    body: BodyMotion, geometry: Geometry, initial_angle: float, angle_error: Array | float = 0.0
) -> WheelRotation:
    """Return the rotation of a wheel that rolls with slip, growth and eccentricity.

    theta' (1 + k theta'²) (1 + A cos(theta - p)) = v_w / R (1 + s v_w'), with contact speed v_w = v - r y_w,
    radius R, tyre growth k, slip s, eccentricity A at phase p, speed v, yaw rate r, and y_w the distance of
    the wheel to the left of the point where v is measured.

    Parameters
    ----------
    body : motion of the vehicle at N times.
    geometry : geometry of vehicle and wheel.
    initial_angle : rad, at the start of the log.
    angle_error : (N,) rad, added to the angle but not to its derivatives: rotation that the inputs missed.
    """
    if geometry.side is None:
        raise ValueError("a node on the body has no wheel")
    y = side_sign(geometry.side) * geometry.track_width / 2.0 - geometry.reference_y
    speed = body.speed - body.yaw_rate * y
    acceleration = body.acceleration - body.yaw_acceleration * y
    angle = (body.distance - body.heading * y) / geometry.radius + initial_angle + angle_error
    spin, spin_acceleration = speed / geometry.radius, acceleration / geometry.radius
    if geometry.wheel_slip:
        angle = angle + 0.5 * geometry.wheel_slip / geometry.radius * (speed**2 - speed[0] ** 2)
        spin_acceleration = spin_acceleration + geometry.wheel_slip / geometry.radius * (
            acceleration**2 + speed * (body.jerk - body.yaw_jerk * y)
        )
        spin = spin * (1.0 + geometry.wheel_slip * acceleration)
    if geometry.tyre_growth or any(geometry.eccentricity):
        return _with_growth_and_eccentricity(
            body.t, geometry, initial_angle, WheelRotation(angle, spin, spin_acceleration)
        )
    return WheelRotation(angle, spin, spin_acceleration)


def _with_growth_and_eccentricity(
    t: Array, geometry: Geometry, start: float, ideal: WheelRotation
) -> WheelRotation:
    """Return the rotation with tyre growth k and eccentricity, given the rotation without either.

    spin (1 + k spin²) (1 + A cos(theta - p)) equals the spin without both. theta + A sin(theta - p) is the
    unrolled arc divided by the radius; growth shortens that arc.
    """
    k, (c, s) = geometry.tyre_growth, geometry.eccentricity
    arc = ideal.angle + c * np.sin(start) - s * np.cos(start)
    arc_loss: Array | float = 0.0
    # Fixed-point iteration: each round gains a factor of the product of both small coefficients.
    for _ in range(3 if k and any((c, s)) else 1 if k else 0):
        arc_loss = _arc_lost_to_growth(t, k, ideal, _unrolled(k, c, s, arc - arc_loss, ideal))
    return _unrolled(k, c, s, arc - arc_loss, ideal)


def _unrolled(k: float, c: float, s: float, arc: Array, ideal: WheelRotation) -> WheelRotation:
    """Return the rotation of the wheel at an unrolled arc, (N,) rad.

    ideal: rotation without growth k and eccentricity (c, s).
    """
    theta = arc
    for _ in range(6 if c or s else 0):
        sin, cos = sin_cos(theta)
        error = theta + c * sin - s * cos - arc
        theta = theta - error / (1.0 + c * cos + s * sin)
        if np.abs(error).max(initial=0.0) < 1e-8:
            break
    sin, cos = sin_cos(theta)
    radius, radius_slope = 1.0 + c * cos + s * sin, s * cos - c * sin
    spin = centred_spin = ideal.spin / radius
    for _ in range(4 if k else 0):
        spin = spin - (spin + k * spin**3 - centred_spin) / (1.0 + 3.0 * k * spin**2)
    growth = 1.0 + k * spin**2
    acceleration = (ideal.spin_acceleration - growth * radius_slope * spin**2) / (
        (growth + 2.0 * k * spin**2) * radius
    )
    return WheelRotation(theta, spin, acceleration)


def _arc_lost_to_growth(t: Array, k: float, ideal: WheelRotation, rolling: WheelRotation) -> Array:
    """Return the arc by which a wheel with tyre growth lags behind one without, (N,) rad.

    Integrated by Hermite's rule, exact for cubics between the times t.
    """
    growth = 1.0 + k * rolling.spin**2
    rate = ideal.spin - ideal.spin / growth
    slope = ideal.spin_acceleration - ideal.spin_acceleration / growth
    slope = slope + ideal.spin * 2.0 * k * rolling.spin * rolling.spin_acceleration / growth**2
    step = np.diff(t)
    increment = 0.5 * step * (rate[1:] + rate[:-1]) + step**2 / 12.0 * (slope[:-1] - slope[1:])
    return np.concatenate([[0.0], np.cumsum(increment)])
