"""Odometry at any rate, cut into stretches between the graph's poses, with what they are worth."""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.factors.between import ComplexArray, OdometrySteps
from hubodo.fuse.track import Track

Pose = tuple[float, float, float, float]
"""t s, x m, y m, heading rad."""


def check_odometry(path: Track) -> None:
    """Raise InputError for odometry that the graph cannot take: too few poses, unordered or not finite.

    Raises ValueError when `step_inflation` does not fit the number of steps.
    """
    n = len(path.t)
    if n < 2 or not bool((np.diff(path.t) > 0.0).all()):
        raise InputError(
            f"odometry of {n} poses: the graph needs at least two, with increasing time; check the nodes"
        )
    if not all(np.isfinite(v).all() and v.shape == (n,) for v in (path.x, path.y, path.heading)):
        raise InputError("odometry has poses that are missing or not finite; check the nodes")
    if len(path.step_inflation) not in (0, n - 1):
        raise ValueError(f"step_inflation has {len(path.step_inflation)} values, not {n - 1}")


@dataclass(frozen=True, slots=True)
class StepNoise:
    """What is random in an odometry that does not say so itself; 1 sigma.

    What a graph begins with: wheels of a real car beside RTK showed 0.01 to 0.05 along and 0.01 to 0.1
    sideways; odometry_noise.py says by how much to multiply it. along, sideways: m per square root of a
    metre. heading: rad per square root of a second, heading_way: rad per square root of a metre. share: of a
    stretch's length and turn (Shah et al. section IV: 0.1), nothing else then. speed_walk: m/s and yaw_walk:
    rad/s per square root of a second, how both wander where `gap` s or more are without a pose. times: by
    what forward, left and heading of each increment are multiplied in the end, whoever told them.
    """

    along: float = 0.04
    sideways: float = 0.04
    heading: float = 3e-4
    heading_per_distance: float = 5e-4
    relative_error: float = 0.0
    speed_walk: float = 1.0
    yaw_walk: float = 0.5
    min_outage: float = 0.5
    sigma_factors: tuple[float, float, float] = (1.0, 1.0, 1.0)


_MIN_SEGMENT_COVARIANCE = np.diag([1e-8, 1e-8, 1e-10])
"""m² and rad² of a stretch.

Below a tenth of a millimetre the equations lose more digits than the odometry has.
"""


@dataclass(frozen=True, eq=False)
class SegmentedOdometry:
    """An odometry cut at the times of the poses.

    pose_t: (n,) s. steps: the stretches. t: (S,) s at the end of each step, stretch: (S,) its number,
    share: (S,) of the stretch's time that has passed then, turn_end: (S, 3) heading, s and m since the
    stretch's start, as Steps.whole. velocity: (n, 2) m/s of the body, forward and left. pose: (n, 3) of the
    odometry, heading unwrapped.
    """

    pose_t: Array
    steps: OdometrySteps
    step_end_t: Array
    segment: NDArray[np.intp]
    elapsed_fraction: Array
    since_segment_start: Array
    velocity: Array
    odometry_pose: Array

    def heading_at(self, t: Array) -> Array:
        """(N,) rad of the odometry at times within the poses', unwrapped."""
        ends = self.odometry_pose[self.segment, 2] + self.since_segment_start[:, 0]
        return np.asarray(
            np.interp(
                t, np.append(self.pose_t[0], self.step_end_t), np.append(self.odometry_pose[0, 2], ends)
            )
        )


def segment_odometry(path: Track, pose_t: Array, noise: StepNoise) -> SegmentedOdometry:
    """Cut at pose_t (n,), increasing, within the odometry's time.

    Between its poses by linear interpolation (Shah et al. Fig. 5).
    """
    inner = path.t[(path.t > pose_t[0]) & (path.t < pose_t[-1])]
    t = np.union1d(inner, pose_t)
    heading = np.interp(t, path.t, np.unwrap(path.heading))
    place = np.interp(t, path.t, path.x) + 1j * np.interp(t, path.t, path.y)
    at_state = np.searchsorted(t, pose_t)
    first = at_state[:-1]
    counts = np.diff(at_state)
    stretch = np.repeat(np.arange(len(first)), counts)
    start = first[stretch]

    middle = 0.5 * (heading[:-1] + heading[1:])
    way: ComplexArray = np.diff(place) * np.exp(-1j * middle)
    distance = np.concatenate([[0.0], np.cumsum(way.real)])
    dt = np.diff(t)
    mid_t = 0.5 * (t[:-1] + t[1:]) - t[start]
    rolled = 0.5 * (distance[:-1] + distance[1:]) - distance[start]
    turn_end = np.column_stack([value[1:] - value[start] for value in (heading, t, distance)])
    whole = np.column_stack([np.diff(value[at_state]) for value in (heading, t, distance)])
    turn = middle - heading[start]
    moves = way * np.exp(1j * turn)
    moved = np.add.reduceat(moves, first)
    covariance = _segment_covariance(path, noise, t, way, turn, moves, moved, first, stretch, whole)
    steps = OdometrySteps(first, way, turn, mid_t, rolled, whole, covariance)

    near = np.clip(at_state, 1, len(way) - 1)
    before = np.clip(near - 1, 0, len(way) - 1)
    velocity = (way[before] + way[np.minimum(near, len(way) - 1)]) / (
        dt[before] + dt[np.minimum(near, len(way) - 1)]
    )
    pose = np.column_stack([place[at_state].real, place[at_state].imag, heading[at_state]])
    share = turn_end[:, 1] / whole[stretch, 1]
    return SegmentedOdometry(
        pose_t, steps, t[1:], stretch, share, turn_end, np.column_stack([velocity.real, velocity.imag]), pose
    )


def _segment_covariance(
    path: Track,
    noise: StepNoise,
    t: Array,
    way: ComplexArray,
    turn: Array,
    moves: ComplexArray,
    moved: ComplexArray,
    first: NDArray[np.intp],
    stretch: NDArray[np.intp],
    whole: Array,
) -> Array:
    """Sum of J Q J' over the steps of a stretch: J turns a step's axes and swings what comes after it."""
    if noise.relative_error > 0.0:
        length, turned = noise.relative_error * np.abs(moved), noise.relative_error * np.abs(whole[:, 0])
        made = np.zeros((len(first), 3, 3))
        made[:, 0, 0] = made[:, 1, 1] = length**2 + 1e-6
        made[:, 2, 2] = turned**2 + 1e-8
        return made
    dt = np.diff(t)
    own = np.searchsorted(path.t, 0.5 * (t[:-1] + t[1:])) - 1
    length = np.diff(path.t)[own]
    q = np.zeros((len(way), 3, 3))
    rolled = np.abs(way)
    hole = np.where(length >= noise.min_outage, length**2 / 12.0 * dt, 0.0)
    q[:, 0, 0] = noise.along**2 * rolled + noise.speed_walk**2 * hole
    q[:, 1, 1] = noise.sideways**2 * rolled
    q[:, 2, 2] = noise.heading**2 * dt + noise.heading_per_distance**2 * rolled + noise.yaw_walk**2 * hole
    q = q * np.outer(noise.sigma_factors, noise.sigma_factors)
    if len(path.step_inflation):
        # What a drive's fixes say of wheels that roll is not said of wheels that do not.
        inflation = path.step_inflation[own] * dt / length
        q[:, 0, 0] += inflation
        q[:, 1, 1] += inflation
    total = np.cumsum(moves)
    base = (total - moves)[first]
    # A turn within a step swings half of it, on average.
    rest = moved[stretch] + base[stretch] - total + 0.5 * moves
    cos, sin = np.cos(turn), np.sin(turn)
    j = np.zeros((len(way), 3, 3))
    j[:, 0, 0] = j[:, 1, 1] = cos
    j[:, 0, 1], j[:, 1, 0] = -sin, sin
    j[:, 0, 2], j[:, 1, 2], j[:, 2, 2] = -rest.imag, rest.real, 1.0
    return np.asarray(np.add.reduceat(j @ q @ j.transpose(0, 2, 1), first, axis=0) + _MIN_SEGMENT_COVARIANCE)


@dataclass(slots=True)
class OdometryBuffer:
    """Poses by increasing time, and how loose the way to each is, as Track's, m²."""

    _poses: deque[Pose] = field(default_factory=deque)
    _inflation: deque[float] = field(default_factory=deque)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def newest_t(self) -> float:
        """s; -inf before the first pose."""
        return self._poses[-1][0] if self._poses else -np.inf

    def add_pose(self, pose: Pose, loose: float) -> None:
        """One more pose."""
        self._poses.append(pose)
        self._inflation.append(loose)

    def drop_before(self, before: float) -> None:
        """Leaves out what is older, but for one pose before that time."""
        while len(self._poses) > 2 and self._poses[1][0] <= before:
            self._poses.popleft()
            self._inflation.popleft()

    def track_since(self, begin: float) -> Track:
        """The odometry since `begin`, with one pose before it."""
        count = 0
        for t, *_ in reversed(self._poses):
            count += 1
            if t <= begin:
                break
        first = len(self._poses) - count
        rows = np.array(list(itertools.islice(self._poses, first, None)))
        loose = np.array(list(itertools.islice(self._inflation, first + 1, None)))
        t, x, y, heading = rows.T
        return Track(t, x, y, heading, step_inflation=loose)

    def segment_between(self, begin: float, end: float, noise: StepNoise) -> SegmentedOdometry:
        """The stretch between two times."""
        return segment_odometry(self.track_since(begin), np.array([begin, end]), noise)
