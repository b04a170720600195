"""Continuous odometry: corrections of the filter are slewed, so that /odom does not jump (ROS REP 105).

Between two poses /odom moves with the filter's speed and yaw rate. What the filter's pose changed beyond
that, at a stop, after a slip or an outage, is a correction, and is added at a limited rate. Without a
correction the pose of the filter is published unchanged.
"""

from __future__ import annotations

import cmath
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array

SLEW_SPEED, SLEW_YAW_RATE = 0.3, 0.15
"""m/s and rad/s by which a correction is added at least: a controller sees a slow drift, and a typical
correction of 0.1 m is complete after a third of a second. Estimated."""

SLEW_TIME = 5.0
"""s; of a large correction a fifth is added in each second. Estimated."""


@dataclass
class ContinuousOdom:
    """Slews the poses of the filter; x, y, heading: m, m, rad, as published; t: s."""

    t: float = 0.0
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    _offset: tuple[complex, float] = (0j, 0.0)
    _has_started: bool = False

    def update(
        self, t: float, x: float, y: float, heading: float, speed: float, yaw_rate: float
    ) -> tuple[float, float, float]:
        """Return the pose to publish at time t, s, for a pose of the filter: m, rad, m/s and rad/s."""
        if self._has_started and t > self.t:
            step, turn = t - self.t, yaw_rate * (t - self.t)
            course = self.heading + 0.5 * turn
            position = complex(self.x, self.y) + speed * step * cmath.exp(1j * course)
            correction, rotation = complex(x, y) - position, heading - self.heading - turn
            remainder = correction * (1.0 - _share(abs(correction), SLEW_SPEED, step))
            remaining_turn = rotation * (1.0 - _share(abs(rotation), SLEW_YAW_RATE, step))
            self._offset = -remainder, -remaining_turn
        self.t, self._has_started = t, True
        self.x, self.y, self.heading = self.offset_pose(x, y, heading)
        return self.x, self.y, self.heading

    def offset_pose(self, x: float, y: float, heading: float) -> tuple[float, float, float]:
        """Return a pose of the filter in the frame as published."""
        offset, angle = self._offset
        if offset == 0j and angle == 0.0:
            return x, y, heading
        return x + offset.real, y + offset.imag, heading + angle

    def covariance(self, covariance: Array) -> Array:
        """Return the covariance (5, 5) of the published pose; the correction that remains is an error."""
        offset, angle = self._offset
        if offset == 0j and angle == 0.0:
            return covariance
        error = np.array([offset.real, offset.imag, angle, 0.0, 0.0])
        return covariance + np.outer(error, error)


def _share(size: float, rate: float, step: float) -> float:
    """Return the share of a correction that is added in a step of some seconds."""
    limit = max(rate, size / SLEW_TIME) * step
    return 1.0 if size <= limit else min(1.0, limit / size)
