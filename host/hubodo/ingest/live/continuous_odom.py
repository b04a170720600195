"""Continuous odometry: corrections of the filter are slewed, so that /odom does not jump (ROS REP 105).

Between two poses /odom moves with the filter's speed and yaw rate. Any further change of the filter's pose,
at a stop, after a slip or an outage, is a correction, and is added at a limited rate. Without a
correction the pose of the filter is published unchanged.

A pose that a user sets is a rigid transform from the frame of the filter to the frame as published. The
estimates of the filter and the map do not change.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array

SLEW_SPEED, SLEW_YAW_RATE = 0.3, 0.15
"""Minimum rates of a correction, m/s and rad/s, chosen so that a typical correction of 0.1 m is complete
after a third of a second and a controller sees a slow drift instead of a jump."""

SLEW_TIME = 5.0
"""Time constant of a large correction, s: a fifth of it is applied in each second, faster than SLEW_SPEED."""


@dataclass(frozen=True, slots=True, eq=False)
class _SetPose:
    """A pose set by a user; position: m, heading: rad, as published; covariance: (3, 3).

    filter_position, filter_heading: pose of the filter at that time.
    """

    position: complex
    heading: float
    covariance: Array
    filter_position: complex
    filter_heading: float

    @property
    def rotation(self) -> float:
        """Angle from the frame of the filter to the frame as published, rad."""
        return self.heading - self.filter_heading

    def transform(self, x: float, y: float, heading: float) -> tuple[float, float, float]:
        """Return a pose of the filter in the frame as published."""
        turned = (complex(x, y) - self.filter_position) * cmath.exp(1j * self.rotation)
        position = self.position + turned
        return position.real, position.imag, heading + self.rotation

    def propagate(self, x: float, y: float, filter_covariance: Array) -> Array:
        """Return the covariance (5, 5) at a published position.

        filter_covariance: (5, 5) of the filter, whose pose is exact when the pose is set.
        The heading error at that time displaces the vehicle across its distance from there.
        """
        turn = np.eye(5)
        cosine, sine = math.cos(self.rotation), math.sin(self.rotation)
        turn[:2, :2] = [[cosine, -sine], [sine, cosine]]
        lever = np.eye(3)
        lever[:2, 2] = self.position.imag - y, x - self.position.real
        covariance = turn @ filter_covariance @ turn.T
        covariance[:3, :3] += lever @ self.covariance @ lever.T
        return covariance


@dataclass
class ContinuousOdom:
    """Slews the poses of the filter.

    t: time of the newest published pose, s; x, y, heading: that pose, m and rad.
    """

    t: float = 0.0
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    _offset: tuple[complex, float] = (0j, 0.0)
    _has_started: bool = False
    _filter_pose: tuple[complex, float] = (0j, 0.0)
    _set_pose: _SetPose | None = None

    def update(
        self, t: float, x: float, y: float, heading: float, speed: float, yaw_rate: float
    ) -> tuple[float, float, float]:
        """Return the pose x, y, heading to publish at time t, s, for the filter's state in SI units."""
        self._filter_pose = complex(x, y), heading
        if self._set_pose is not None:
            x, y, heading = self._set_pose.transform(x, y, heading)
        if self._has_started and t > self.t:
            step, turn = t - self.t, yaw_rate * (t - self.t)
            course = self.heading + 0.5 * turn
            position = complex(self.x, self.y) + speed * step * cmath.exp(1j * course)
            correction, rotation = complex(x, y) - position, heading - self.heading - turn
            remainder = correction * (1.0 - _share(abs(correction), SLEW_SPEED, step))
            remaining_turn = rotation * (1.0 - _share(abs(rotation), SLEW_YAW_RATE, step))
            self._offset = -remainder, -remaining_turn
        self.t, self._has_started = t, True
        self.x, self.y, self.heading = self._add_offset(x, y, heading)
        return self.x, self.y, self.heading

    def set_pose(self, x: float, y: float, heading: float, covariance: Array) -> None:
        """Make this the newest published pose, at once; covariance: (3, 3) of x, y, heading in m and rad."""
        self._set_pose = _SetPose(complex(x, y), heading, covariance, *self._filter_pose)
        self._offset = (0j, 0.0)
        self.x, self.y, self.heading = x, y, heading

    def to_published(self, x: float, y: float, heading: float) -> tuple[float, float, float]:
        """Return a pose of the filter in the frame as published."""
        if self._set_pose is not None:
            x, y, heading = self._set_pose.transform(x, y, heading)
        return self._add_offset(x, y, heading)

    def _add_offset(self, x: float, y: float, heading: float) -> tuple[float, float, float]:
        offset, angle = self._offset
        if offset == 0j and angle == 0.0:
            return x, y, heading
        return x + offset.real, y + offset.imag, heading + angle

    def covariance(self, covariance: Array) -> Array:
        """Return the covariance (5, 5) of the published pose; a pending correction counts as an error."""
        if self._set_pose is not None:
            covariance = self._set_pose.propagate(self.x, self.y, covariance)
        offset, angle = self._offset
        if offset == 0j and angle == 0.0:
            return covariance
        error = np.array([offset.real, offset.imag, angle, 0.0, 0.0])
        return covariance + np.outer(error, error)


def _share(size: float, rate: float, step: float) -> float:
    """Return the share of a correction that is applied in one step.

    size: correction, m or rad; rate: minimum slew rate, m/s or rad/s; step: duration, s.
    """
    limit = max(rate, size / SLEW_TIME) * step
    return 1.0 if size <= limit else min(1.0, limit / size)
