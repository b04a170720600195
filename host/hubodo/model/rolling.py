"""How a wheel turns: its angle, spin and spin acceleration from the motion of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Geometry
from hubodo.model.inputs import Body
from hubodo.vehicle import side_sign


@dataclass(frozen=True, slots=True)
class Rolling:
    """angle rad, spin rad/s, spin_acceleration rad/s² of a wheel, each (N,)."""

    angle: Array
    spin: Array
    spin_acceleration: Array

    def part(self, samples: slice) -> Rolling:
        """Of some of the times."""
        return Rolling(self.angle[samples], self.spin[samples], self.spin_acceleration[samples])


def roll(body: Body, geometry: Geometry, start: float, phase: Array | float = 0.0) -> Rolling:
    """The wheel rolls over the ground: theta' = v_w / (R (1 + k theta'²)(1 + A cos(theta - p))) (1 + s v_w').

    start: rad at the log's start. phase: (N,) rad, added to the angle, not to its rates: what the wheel
    turned that the inputs do not know. v_w = v - r y_w, y_w from where v is measured.
    """
    if geometry.side is None:
        raise ValueError("a node on the body has no wheel to roll")
    y = side_sign(geometry.side) * geometry.track_width / 2.0 - geometry.aside
    speed = body.speed - body.yaw_rate * y
    acceleration = body.acceleration - body.yaw_acceleration * y
    angle = (body.distance - body.heading * y) / geometry.radius + start + phase
    spin, spin_acceleration = speed / geometry.radius, acceleration / geometry.radius
    if geometry.slip:
        angle = angle + 0.5 * geometry.slip / geometry.radius * (speed**2 - speed[0] ** 2)
        spin_acceleration = spin_acceleration + geometry.slip / geometry.radius * (
            acceleration**2 + speed * (body.jerk - body.yaw_jerk * y)
        )
        spin = spin * (1.0 + geometry.slip * acceleration)
    if geometry.growth or any(geometry.eccentricity):
        return _uneven(body.t, geometry, start, Rolling(angle, spin, spin_acceleration))
    return Rolling(angle, spin, spin_acceleration)


def _uneven(t: Array, geometry: Geometry, start: float, even: Rolling) -> Rolling:
    """A wheel off its centre that grows: spin (1 + k spin²) (1 + A cos(theta - p)) is its spin without both.

    theta + A sin(theta - p) is the arc it unrolls; growth takes from that arc.
    """
    k, (c, s) = geometry.growth, geometry.eccentricity
    arc = even.angle + c * np.sin(start) - s * np.cos(start)
    lost: Array | float = 0.0
    # Each corrects the other's cause by the product of two small numbers: three rounds are plenty.
    for _ in range(3 if k and any((c, s)) else 1 if k else 0):
        lost = _lost(t, k, even, _turned(k, c, s, arc - lost, even))
    return _turned(k, c, s, arc - lost, even)


def _turned(k: float, c: float, s: float, arc: Array, even: Rolling) -> Rolling:
    """The wheel when it has unrolled `arc`, (N,) rad."""
    theta = arc
    for _ in range(6 if c or s else 0):
        cos, sin = np.cos(theta), np.sin(theta)
        error = theta + c * sin - s * cos - arc
        theta = theta - error / (1.0 + c * cos + s * sin)
        if np.abs(error).max(initial=0.0) < 1e-8:
            break
    cos, sin = np.cos(theta), np.sin(theta)
    radius, radius_slope = 1.0 + c * cos + s * sin, s * cos - c * sin
    spin = centred = even.spin / radius
    for _ in range(4 if k else 0):
        spin = spin - (spin + k * spin**3 - centred) / (1.0 + 3.0 * k * spin**2)
    growth = 1.0 + k * spin**2
    acceleration = (even.spin_acceleration - growth * radius_slope * spin**2) / (
        (growth + 2.0 * k * spin**2) * radius
    )
    return Rolling(theta, spin, acceleration)


def _lost(t: Array, k: float, even: Rolling, turned: Rolling) -> Array:
    """(N,) rad of arc that a growing wheel has fallen behind; Hermite's rule, exact for cubics between t."""
    growth = 1.0 + k * turned.spin**2
    rate = even.spin - even.spin / growth
    slope = even.spin_acceleration - even.spin_acceleration / growth
    slope = slope + even.spin * 2.0 * k * turned.spin * turned.spin_acceleration / growth**2
    step = np.diff(t)
    part = 0.5 * step * (rate[1:] + rate[:-1]) + step**2 / 12.0 * (slope[:-1] - slope[1:])
    return np.concatenate([[0.0], np.cumsum(part)])
