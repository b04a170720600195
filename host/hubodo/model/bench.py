"""Motion of nodes on a bench: a turntable with stops, and a sequence of hand-held poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE, STANDARD_GRAVITY
from hubodo.model.inputs import EarthRotation, MotionInputs
from hubodo.smoothing_spline import constant_spline, fit_interpolating_spline

_TABLE_STEP = 0.01  # s, sampling of the motion of a turntable
_TABLE_REPORT_STEP = 0.1  # s, sampling of the record of its angle


def quintic_step(progress: Array) -> tuple[Array, Array, Array]:
    """Return a quintic polynomial from 0 to 1 over `progress`, (N,), with its first and second derivative.

    Both derivatives are zero at both ends.
    """
    s = np.clip(progress, 0.0, 1.0)
    return (
        s**3 * (10.0 + s * (6.0 * s - 15.0)),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )


@dataclass(frozen=True)
class TurntableProgramme:
    """A cyclic turntable programme: stops of `stop_time` s at `angles` in rad, turns of `turn_time` s."""

    angles: tuple[float, ...]
    stop_time: float
    turn_time: float

    def inputs_and_record(
        self, duration: float, earth: EarthRotation | None = None
    ) -> tuple[MotionInputs, Array]:
        """Return the motion of a turntable that follows the programme for `duration` s, and its record.

        The motion is that of a vehicle turning on the spot. The record is (N, 3) at 10 Hz: t in s, angle in
        rad, and 1 while the table moves, else 0.
        """
        t = np.linspace(0.0, duration, max(8, round(duration / _TABLE_STEP) + 1))
        stop, progress = self._stop_and_progress(t)
        angles = np.array(self.angles)
        step = angles[(stop + 1) % len(angles)] - angles[stop % len(angles)]
        yaw_rate = fit_interpolating_spline(t, step * quintic_step(progress)[1] / self.turn_time)
        report_t: Array = np.arange(0.0, duration, _TABLE_REPORT_STEP)
        angle = angles[0] + yaw_rate.integral(report_t)
        moving = (self._stop_and_progress(report_t)[1] > -1e-9).astype(np.float64)
        inputs = MotionInputs(constant_spline(0.0, 0.0, duration), yaw_rate, earth=earth)
        return inputs, np.stack([report_t, angle, moving], axis=1)

    def _stop_and_progress(self, t: Array) -> tuple[NDArray[np.int64], Array]:
        """Return the index of the last stop, and the progress of the turn after it; negative at a stop."""
        period = self.stop_time + self.turn_time
        number = np.floor(t / period + 1e-9).astype(np.int64)
        return number, (t - number * period - self.stop_time) / self.turn_time


@dataclass(frozen=True)
class PoseSequence:
    """A node held still in one attitude after another; calling it returns a motion as `CarriedMotion` does.

    Attributes
    ----------
    attitudes : (P,) rotations from the node to the world (x east, y north, z up). Each turn between two of
        them is about one axis fixed in the node.
    rest_time, turn_time : s, duration of each standstill and of each turn.
    latitude : rad; if given, the rate includes the rotation of the Earth.
    """

    attitudes: Rotation
    rest_time: float = 6.0
    turn_time: float = 2.5
    latitude: float | None = None

    @property
    def duration(self) -> float:
        """Return the duration in s, from the first pose to the last."""
        return len(self.attitudes) * (self.rest_time + self.turn_time) - self.turn_time

    @cached_property
    def _rotation_vectors(self) -> Array:
        """Return the rotation vector of each turn in node axes, (P, 3); zero after the last pose."""
        between = (self.attitudes[:-1].inv() * self.attitudes[1:]).as_rotvec()
        return np.concatenate([between, np.zeros((1, 3))])

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Return angular rate, its derivative and specific force in node axes, (3, N), at t, (N,) s."""
        period = self.rest_time + self.turn_time
        number = np.clip(np.floor(t / period).astype(np.int64), 0, len(self.attitudes) - 1)
        angle, speed, acceleration = quintic_step((t - number * period - self.rest_time) / self.turn_time)
        rotation = self._rotation_vectors[number]
        world = (self.attitudes[number] * Rotation.from_rotvec(angle[:, None] * rotation)).inv()
        rate = speed[:, None] / self.turn_time * rotation
        rate_derivative = acceleration[:, None] / self.turn_time**2 * rotation
        if self.latitude is not None:
            earth = world.apply(EARTH_RATE * np.array([0.0, np.cos(self.latitude), np.sin(self.latitude)]))
            rate_derivative = rate_derivative - np.cross(rate, earth)
            rate = rate + earth
        return rate.T, rate_derivative.T, world.apply([0.0, 0.0, STANDARD_GRAVITY]).T
