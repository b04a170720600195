"""Headings of a magnetic compass on a vehicle with iron, generated without the model under test.

The horizontal field is a vector in the world, 20 uT to the north. Two magnetometer axes of the level vehicle
read it through a soft-iron matrix, with a hard-iron vector of the vehicle and, for a part of the drive, a
field of something beside the road. The heading is what a compass shows: the direction of the two readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HORIZONTAL_FIELD = 20e-6
"""T, as in central Europe."""


@dataclass(frozen=True)
class Iron:
    """Iron of a vehicle, and a magnetic disturbance, as fractions of the horizontal field.

    hard, soft: hard and soft iron of the vehicle. disturbance: field beside the road for `share` of the time.
    """

    hard: float = 0.0
    soft: float = 0.0
    disturbance: float = 0.0
    share: float = 0.0


def headings(rng, t, heading, iron, noise=0.02, slow_error=0.02):
    """Return the headings that a compass shows at times t (N,), s, on a vehicle with true heading (N,), rad.

    Headings are anticlockwise from east. noise: 1 sigma of a sample, as a fraction of the field. slow_error:
    1 sigma of an error with a time constant of 5 s (tilt of the vehicle), rad.
    """
    cos, sin = np.cos(heading), np.sin(heading)
    north = np.array([[0.0], [HORIZONTAL_FIELD]]) * np.ones(len(t))
    if iron.disturbance:
        start = rng.uniform(0.1, 0.9 - iron.share) * t[-1]
        near = (t > start) & (t < start + iron.share * t[-1])
        direction = rng.uniform(-np.pi, np.pi)
        extra = iron.disturbance * HORIZONTAL_FIELD * np.array([np.cos(direction), np.sin(direction)])
        north = north + extra[:, None] * near
    body = np.array([cos * north[0] + sin * north[1], cos * north[1] - sin * north[0]])
    stretch = rng.standard_normal((2, 2))
    stretch = 0.5 * (stretch + stretch.T)
    stretch *= iron.soft / np.linalg.norm(stretch, 2)
    body = body + stretch @ body
    angle = rng.uniform(-np.pi, np.pi)
    body = body + iron.hard * HORIZONTAL_FIELD * np.array([[np.cos(angle)], [np.sin(angle)]])
    body = body + noise * HORIZONTAL_FIELD * rng.standard_normal(body.shape)
    slow = np.zeros(len(t))
    decay = np.exp(-np.diff(t, prepend=t[0]) / 5.0)
    drive = rng.standard_normal(len(t))
    for k in range(len(t)):
        slow[k] = (
            decay[k] * slow[k - 1] + slow_error * np.sqrt(1.0 - decay[k] ** 2) * drive[k]
            if k
            else slow_error * drive[0]
        )
    shown = 0.5 * np.pi - np.arctan2(body[1], body[0]) + slow
    return np.mod(shown + np.pi, 2.0 * np.pi) - np.pi
