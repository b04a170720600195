"""Input, output and record of one step of the wheel filter, and the ring buffer of records."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

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
    covariance : (5, 5) of x, y, heading, speed, yaw_rate.
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


def add_common_scale(pose: Pose, sigma: float, origin: tuple[float, float] = (0.0, 0.0)) -> Pose:
    """Return the pose with the covariance of a scale error common to all wheels, 1 sigma as a fraction.

    The error scales the speed, and the track about the origin, where the position was exact; no measurement
    of the filter shows it.
    """
    if not sigma:
        return pose
    scaled = sigma * np.array([pose.x - origin[0], pose.y - origin[1], 0.0, pose.speed, 0.0])
    return pose._replace(covariance=pose.covariance + np.outer(scaled, scaled))


class SmoothingTerms(NamedTuple):
    """Terms of one step for a backward smoothing pass.

    Attributes
    ----------
    prior_x, prior_p : states and covariance before the measurements.
    x, p : states and covariance after them.
    reset_states : columns that were reset in this step and so carry no information about the past.
    transition : (n, n), derivatives of the states at the end of the step by x.
    speed_row : column of the speed and its derivatives (n,) by the states at the end of the previous step, if
        the accelerometers propagated it.
    outage_transition : (n, n), derivatives of prior_x by the states at the end of the previous step; None if
        no outage lies between the two.
    heading_inflation : (2, 2) m², second-order covariance of x and y beyond p.
    """

    prior_x: list[float]
    prior_p: Array
    x: list[float]
    p: Array
    reset_states: Sequence[int]
    transition: Array
    heading_inflation: Array
    speed_row: tuple[int, Array] | None = None
    outage_transition: Array | None = None


class StepRecord(NamedTuple):
    """Record of one step, for rollback and for smoothing.

    Attributes
    ----------
    number : number of its (last) window.
    windows, motion_states : derotated windows of all wheels and the motion state of each; empty in an outage.
    start_x, start_p : states and covariance at the start of the window.
    pose, smoothing : set at the end of the step; smoothing terms only if they are recorded.
    """

    number: int
    windows: WheelWindows
    motion_states: Sequence[MotionState]
    start_x: list[float]
    start_p: Array
    pose: Pose | None = None
    smoothing: SmoothingTerms | None = None


class History:
    """A ring buffer of the newest step records, for rollback and smoothing.

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

    def replace_newest(self, record: StepRecord) -> None:
        """Complete the newest record at the end of its step."""
        self._records[-1] = record

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
