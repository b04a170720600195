"""What is done with nodes on a bench: turned on a table from stop to stop, carried from pose to pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE, STANDARD_GRAVITY
from hubodo.model.inputs import Earth, Inputs
from hubodo.smoothing_spline import constant_spline, fit_interpolating_spline

_STEP, _REPORT = 0.01, 0.1


def eased(share: Array) -> tuple[Array, Array, Array]:
    """From 0 to 1 as share, (N,), does, but at rest at both ends: value, first and second derivative."""
    s = np.clip(share, 0.0, 1.0)
    return (
        s**3 * (10.0 + s * (6.0 * s - 15.0)),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )


@dataclass(frozen=True)
class Programme:
    """Stops of `stop` s with turns of `turn` s between; angles: rad, begun anew when they are through."""

    angles: tuple[float, ...]
    stop: float
    turn: float

    def table(self, duration: float, earth: Earth | None = None) -> tuple[Inputs, Array]:
        """A turntable that follows it for `duration` s.

        Gives the inputs of a vehicle that turns on the spot, and what the table reports ten times a second,
        (N, 3): t s, angle rad, and 1 while it moves, else 0.
        """
        t = np.linspace(0.0, duration, max(8, round(duration / _STEP) + 1))
        number, share = self._place(t)
        angles = np.array(self.angles)
        leap = angles[(number + 1) % len(angles)] - angles[number % len(angles)]
        turning = fit_interpolating_spline(t, leap * eased(share)[1] / self.turn)
        at: Array = np.arange(0.0, duration, _REPORT)
        angle = angles[0] + turning.integral(at)
        moving = (self._place(at)[1] > -1e-9).astype(np.float64)
        inputs = Inputs(constant_spline(0.0, 0.0, duration), turning, earth=earth)
        return inputs, np.stack([at, angle, moving], axis=1)

    def _place(self, t: Array) -> tuple[NDArray[np.int64], Array]:
        """Which stop it is, and how much of the turn after it is done (negative while it stands)."""
        period = self.stop + self.turn
        number = np.floor(t / period + 1e-9).astype(np.int64)
        return number, (t - number * period - self.stop) / self.turn


@dataclass(frozen=True)
class Handled:
    """A node carried from rest to rest, each turn about one axis fixed in it; a `forward.Carried`.

    attitudes: (P,) node to world (x east, y north, z up). rest, turn: s. latitude: rad; with it the Earth
    turns.
    """

    attitudes: Rotation
    rest: float = 6.0
    turn: float = 2.5
    latitude: float | None = None

    @property
    def duration(self) -> float:
        """s, from the first rest to the last."""
        return len(self.attitudes) * (self.rest + self.turn) - self.turn

    @cached_property
    def _turns(self) -> Array:
        """(P, 3) rotation vector of each turn in the node, zero after the last pose."""
        between = (self.attitudes[:-1].inv() * self.attitudes[1:]).as_rotvec()
        return np.concatenate([between, np.zeros((1, 3))])

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Angular rate, its derivative and specific force in node axes, (3, N), at t, (N,) s."""
        period = self.rest + self.turn
        number = np.clip(np.floor(t / period).astype(np.int64), 0, len(self.attitudes) - 1)
        share, speed, pull = eased((t - number * period - self.rest) / self.turn)
        by = self._turns[number]
        world = (self.attitudes[number] * Rotation.from_rotvec(share[:, None] * by)).inv()
        rate = speed[:, None] / self.turn * by
        slope = pull[:, None] / self.turn**2 * by
        if self.latitude is not None:
            earth = world.apply(EARTH_RATE * np.array([0.0, np.cos(self.latitude), np.sin(self.latitude)]))
            slope = slope - np.cross(rate, earth)
            rate = rate + earth
        return rate.T, slope.T, world.apply([0.0, 0.0, STANDARD_GRAVITY]).T
