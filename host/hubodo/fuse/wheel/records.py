"""Input, output and records of one step of the wheel filter, their ring buffer, and the slip schedule."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import HEADING, SPEED, YAW_RATE, X, Y
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.fuse.wheel.window import Window

POSE_ENTRIES = (X, Y, HEADING, SPEED, YAW_RATE)
"""States of a pose, in its order."""

WheelWindows = Sequence[tuple[Wheel, Window]]
"""Each wheel with its window, in the order of the nodes."""


class StepInput(NamedTuple):
    """Input of one step: the windows of all wheels with one number, in the order of the nodes.

    Attributes
    ----------
    windows : empty in an outage of all wheels.
    number : number of the (last) window.
    realign : True if wheels with unknown angle gather gravity in this step.
    spans : number of windows that the step covers; above 1 only in an outage.
    surface_speeds : m/s of the left and right wheel from another odometer, or None.
    """

    windows: tuple[Window, ...]
    number: int
    realign: bool
    spans: int = 1
    surface_speeds: tuple[float, float] | None = None


class Pose(NamedTuple):
    """Pose of the body origin at the end of a step.

    Attributes
    ----------
    t : s.
    x, y, heading : m, m, rad; the heading is unwrapped.
    speed, yaw_rate : m/s and rad/s, means over the window.
    covariance : (5, 5) of x, y, heading, speed, yaw_rate; (0, 0) until smoothing has computed it.
    motion_state : moving, rocking or standstill.
    nis, dof : normalised innovation squared of the step and its degrees of freedom.
    inertial_speed : True if no wheel but only accelerometers measured the speed.
    published : x, y, heading on /odom at the same time, where corrections are slewed; None in bulk.
    """

    t: float
    x: float
    y: float
    heading: float
    speed: float
    yaw_rate: float
    covariance: Array
    motion_state: MotionState
    nis: float
    dof: int
    inertial_speed: bool = False
    published: tuple[float, float, float] | None = None


def common_scale_covariance(sigma: float, x: float | Array, y: float | Array, speed: float | Array) -> Array:
    """Return the covariance (..., 5, 5) of poses for a scale error common to all wheels; sigma: a fraction.

    The error scales the speed, and the track about the origin of x and y, where the position was exact; no
    measurement of the filter shows it.
    """
    scaled = np.array([sigma * x, sigma * y, 0.0 * x, sigma * speed, 0.0 * x]).T
    covariance: Array = scaled[..., None] * scaled[..., None, :]
    return covariance


class MeasurementTerms(NamedTuple):
    """A Kalman update by m measurements with independent errors of variance 1, for smoothing.

    Attributes
    ----------
    innovation : (m,), whitened innovations L^-1 z, with L L' = H P H' + R.
    jacobian : (m, n), L^-1 H.
    gain_root : (m, n), L^-1 H P; the gain of the whitened innovations is its transpose.
    """

    innovation: Array
    jacobian: Array
    gain_root: Array

    @classmethod
    def of_row(cls, residual: float, h: Array, ph: Array, s: float) -> MeasurementTerms:
        """Return the terms of one measurement: derivatives h (n,), ph = P h, innovation variance s."""
        root = math.sqrt(s)
        return cls(np.array([residual / root]), h[None] / root, ph[None] / root)


class StateTransition(NamedTuple):
    """A linear change of some states, for smoothing; without derivatives a reset.

    Attributes
    ----------
    columns : (k,), the states that change.
    places : flat indices in the (k, n) derivatives of these states by all states before.
    values : the derivatives at these places; all others are zero.
    """

    columns: Sequence[int]
    places: NDArray[np.intp] = np.empty(0, np.intp)
    values: Array = np.empty(0)

    @classmethod
    def of_rows(cls, columns: Sequence[int], rows: Array) -> StateTransition:
        """Return the transition with these rows of derivatives (k, n)."""
        return cls(columns, np.arange(rows.size), rows.ravel())

    @property
    def selection(self) -> slice | Sequence[int]:
        """Return the columns as an index of an array; a slice is several times faster than a list."""
        columns = self.columns
        return slice(columns.start, columns.stop) if isinstance(columns, range) else columns

    def rows(self, n_states: int) -> Array:
        """Return the derivatives (k, n)."""
        rows = np.zeros((len(self.columns), n_states))
        rows.ravel()[self.places] = self.values
        return rows


StateChange = MeasurementTerms | StateTransition


class SmoothingTerms(NamedTuple):
    """Terms of one step for smoothing.

    Attributes
    ----------
    changes : updates and transitions since the previous pose, in their order. Noise and known inputs are no
        changes: what smoothing needs of them is in `pose_rows`.
    pose_rows : (5, n), covariance of the states of the pose with all states at the end of the step.
    heading_inflation : (5, 5), second-order covariance of the pose beyond that, of x and y only.
    """

    changes: Sequence[StateChange]
    pose_rows: Array
    heading_inflation: Array


class StepRecord(NamedTuple):
    """Record of one step, for rollback.

    Attributes
    ----------
    number : number of its (last) window.
    windows, motion_states : derotated windows of all wheels and the motion state of each; empty in an outage.
    start_x, start_p : states and covariance at the start of the window.
    """

    number: int
    windows: WheelWindows
    motion_states: Sequence[MotionState]
    start_x: list[float]
    start_p: Array


class History:
    """A ring buffer of the newest step records, for rollback.

    A replay restores the states at the start of a step and processes the windows since then again. It
    reproduces only changes by the windows themselves, so any other change of the state is a barrier.
    """

    def __init__(self, n_steps: int) -> None:
        self._records: deque[StepRecord] = deque(maxlen=n_steps)
        self._n_replayable = 0

    def append(self, record: StepRecord) -> None:
        """Add the newest step."""
        self._records.append(record)
        self._n_replayable = min(self._n_replayable + 1, len(self._records))

    def set_barrier(self) -> None:
        """Exclude all steps so far from a replay."""
        self._n_replayable = 0

    @property
    def newest(self) -> StepRecord:
        """Return the newest record."""
        return self._records[-1]

    @property
    def is_replayable(self) -> bool:
        """Return True if at least the newest step can be replayed."""
        return self._n_replayable > 0

    @property
    def first_replayable(self) -> int:
        """Return the window number of the oldest step that can be replayed."""
        return self._records[-self._n_replayable].number

    def pop_since(self, number: int) -> list[StepRecord]:
        """Remove and return the replayable records from window `number` on, oldest first."""
        popped: list[StepRecord] = []
        while self._n_replayable and self._records[-1].number >= number:
            popped.append(self._records.pop())
            self._n_replayable -= 1
        return popped[::-1]


@dataclass
class SlipSchedule:
    """Slipping wheels and additional speed variance, by window.

    Attributes
    ----------
    n_wheels : number of wheels.
    slipping : for each wheel whether it slips, by window number; windows without slip are not in it.
    speed_variance : (m/s)², added to the variance of the speed before a window, by window number.
    """

    n_wheels: int
    slipping: dict[int, tuple[bool, ...]] = field(default_factory=dict)
    speed_variance: dict[int, float] = field(default_factory=dict)

    def mark(self, wheel: int, numbers: range, slipping: bool = True) -> None:
        """Set whether a wheel slips in these windows."""
        for number in numbers:
            flags = list(self.slipping_wheels(number))
            flags[wheel] = slipping
            if any(flags):
                self.slipping[number] = tuple(flags)
            else:
                self.slipping.pop(number, None)

    def inflate_speed(self, numbers: range, square: float) -> None:
        """Distribute a squared speed error, (m/s)², that showed at the end of these windows.

        The error arose at an unknown time, so every window gets the same share: a random walk. Between both
        ends that is a Brownian bridge, with the variance of a jump at a uniformly distributed time.
        """
        for number in numbers:
            self.speed_variance[number] = self.speed_variance.get(number, 0.0) + square / len(numbers)

    def count_windows(self, wheel: int) -> int:
        """Return the number of windows in which a wheel slips."""
        return sum(flags[wheel] for flags in self.slipping.values())

    def all_slipping_before(self, number: int) -> bool:
        """Return True if all wheels slip in the window before."""
        return all(self.slipping_wheels(number - 1))

    def slipping_wheels(self, number: int) -> tuple[bool, ...]:
        """Return for each wheel whether it slips in a window."""
        return self.slipping.get(number, (False,) * self.n_wheels)
