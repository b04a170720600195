"""Odometry at any rate, cut into segments between the poses of a graph, with their covariance."""

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
    """Raise InputError for odometry that the graph cannot use: too few poses, unordered or not finite.

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
    """Random errors of an odometry without a covariance of its own; 1 sigma.

    Odometry of a real car, compared with RTK, showed 0.01 to 0.05 m/√m along and 0.01 to 0.1 m/√m across.
    These are initial values: odometry_noise.py estimates factors on them.

    Attributes
    ----------
    along, sideways : m per √m.
    heading : rad per √s.
    heading_per_distance : rad per √m.
    relative_error : fraction of a segment's length and turn (Shah et al. section IV: 0.1); if it is above 0,
        the other sigmas are unused.
    speed_walk, yaw_walk : m/s and rad/s per √s, random walks where `min_outage` s or more have no pose.
    min_outage : s.
    sigma_factors : factors on forward, left and heading of each increment.
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
"""m² and rad² of a segment.

Below a tenth of a millimetre the equations lose more digits than the odometry has.
"""


@dataclass(frozen=True, eq=False)
class SegmentedOdometry:
    """Odometry cut at the times of the poses, with n poses and S steps.

    Attributes
    ----------
    pose_t : (n,) s.
    steps : the segments between the poses.
    step_end_t : (S,) s, end of each step.
    segment : (S,) number of its segment.
    elapsed_fraction : (S,) fraction of the segment's time that has passed at its end.
    since_segment_start : (S, 3) heading, s and m since the segment's start, as OdometrySteps.totals.
    velocity : (n, 2) m/s of the body, forward and left.
    odometry_pose : (n, 3) pose of the odometry, heading unwrapped.
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
        """Return the odometry's heading, unwrapped, at times within those of the poses, (N,) rad."""
        ends = self.odometry_pose[self.segment, 2] + self.since_segment_start[:, 0]
        return np.asarray(
            np.interp(
                t, np.append(self.pose_t[0], self.step_end_t), np.append(self.odometry_pose[0, 2], ends)
            )
        )


def segment_odometry(path: Track, pose_t: Array, noise: StepNoise) -> SegmentedOdometry:
    """Cut odometry at increasing times pose_t (n,) within its duration.

    Between odometry poses the path is interpolated linearly (Shah et al. Fig. 5).
    """
    inner_t = path.t[(path.t > pose_t[0]) & (path.t < pose_t[-1])]
    t = np.union1d(inner_t, pose_t)
    heading = np.interp(t, path.t, np.unwrap(path.heading))
    position = np.interp(t, path.t, path.x) + 1j * np.interp(t, path.t, path.y)
    at_pose = np.searchsorted(t, pose_t)
    first_step = at_pose[:-1]
    step_counts = np.diff(at_pose)
    segment = np.repeat(np.arange(len(first_step)), step_counts)
    step_start = first_step[segment]

    mid_heading = 0.5 * (heading[:-1] + heading[1:])
    chord: ComplexArray = np.diff(position) * np.exp(-1j * mid_heading)
    cumulative_distance = np.concatenate([[0.0], np.cumsum(chord.real)])
    dt = np.diff(t)
    mid_time = 0.5 * (t[:-1] + t[1:]) - t[step_start]
    mid_distance = (
        0.5 * (cumulative_distance[:-1] + cumulative_distance[1:]) - cumulative_distance[step_start]
    )
    since_start = np.column_stack(
        [value[1:] - value[step_start] for value in (heading, t, cumulative_distance)]
    )
    totals = np.column_stack([np.diff(value[at_pose]) for value in (heading, t, cumulative_distance)])
    mid_turn = mid_heading - heading[step_start]
    displacements = chord * np.exp(1j * mid_turn)
    segment_displacement = np.add.reduceat(displacements, first_step)
    covariance = _segment_covariance(
        path, noise, t, chord, mid_turn, displacements, segment_displacement, first_step, segment, totals
    )
    steps = OdometrySteps(first_step, chord, mid_turn, mid_time, mid_distance, totals, covariance)

    nearest_step = np.clip(at_pose, 1, len(chord) - 1)
    previous_step = np.clip(nearest_step - 1, 0, len(chord) - 1)
    velocity = (chord[previous_step] + chord[np.minimum(nearest_step, len(chord) - 1)]) / (
        dt[previous_step] + dt[np.minimum(nearest_step, len(chord) - 1)]
    )
    odometry_pose = np.column_stack([position[at_pose].real, position[at_pose].imag, heading[at_pose]])
    elapsed_fraction = since_start[:, 1] / totals[segment, 1]
    return SegmentedOdometry(
        pose_t,
        steps,
        t[1:],
        segment,
        elapsed_fraction,
        since_start,
        np.column_stack([velocity.real, velocity.imag]),
        odometry_pose,
    )


def _segment_covariance(
    path: Track,
    noise: StepNoise,
    t: Array,
    chord: ComplexArray,
    mid_turn: Array,
    displacements: ComplexArray,
    segment_displacement: ComplexArray,
    first_step: NDArray[np.intp],
    segment: NDArray[np.intp],
    totals: Array,
) -> Array:
    """Return the sum of J Q J' over the steps of each segment.

    Q is the covariance of a step in its own axes; J propagates it to the end of the segment.
    """
    if noise.relative_error > 0.0:
        step_duration, total_turn = (
            noise.relative_error * np.abs(segment_displacement),
            noise.relative_error * np.abs(totals[:, 0]),
        )
        covariance = np.zeros((len(first_step), 3, 3))
        covariance[:, 0, 0] = covariance[:, 1, 1] = step_duration**2 + 1e-6
        covariance[:, 2, 2] = total_turn**2 + 1e-8
        return covariance
    dt = np.diff(t)
    odometry_step = np.searchsorted(path.t, 0.5 * (t[:-1] + t[1:])) - 1
    step_duration = np.diff(path.t)[odometry_step]
    q = np.zeros((len(chord), 3, 3))
    distance = np.abs(chord)
    outage_weight = np.where(step_duration >= noise.min_outage, step_duration**2 / 12.0 * dt, 0.0)
    q[:, 0, 0] = noise.along**2 * distance + noise.speed_walk**2 * outage_weight
    q[:, 1, 1] = noise.sideways**2 * distance
    q[:, 2, 2] = (
        noise.heading**2 * dt + noise.heading_per_distance**2 * distance + noise.yaw_walk**2 * outage_weight
    )
    q = q * np.outer(noise.sigma_factors, noise.sigma_factors)
    if len(path.step_inflation):
        # Factors estimated for rolling wheels do not apply to segments without wheel speed.
        inflation = path.step_inflation[odometry_step] * dt / step_duration
        q[:, 0, 0] += inflation
        q[:, 1, 1] += inflation
    cumulative = np.cumsum(displacements)
    segment_base = (cumulative - displacements)[first_step]
    # A turn within a step rotates half of it, on average.
    remaining = segment_displacement[segment] + segment_base[segment] - cumulative + 0.5 * displacements
    cos, sin = np.cos(mid_turn), np.sin(mid_turn)
    j = np.zeros((len(chord), 3, 3))
    j[:, 0, 0] = j[:, 1, 1] = cos
    j[:, 0, 1], j[:, 1, 0] = -sin, sin
    j[:, 0, 2], j[:, 1, 2], j[:, 2, 2] = -remaining.imag, remaining.real, 1.0
    return np.asarray(
        np.add.reduceat(j @ q @ j.transpose(0, 2, 1), first_step, axis=0) + _MIN_SEGMENT_COVARIANCE
    )


@dataclass(slots=True)
class OdometryBuffer:
    """The newest odometry poses (t, x, y, heading) by time, with the inflation of the step to each, m²."""

    _poses: deque[Pose] = field(default_factory=deque)
    _inflation: deque[float] = field(default_factory=deque)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def newest_t(self) -> float:
        """Return the time of the newest pose, s; -inf before the first."""
        return self._poses[-1][0] if self._poses else -np.inf

    def add_pose(self, pose: Pose, step_inflation: float) -> None:
        """Add a pose and the inflation of the step to it, m²."""
        self._poses.append(pose)
        self._inflation.append(step_inflation)

    def drop_before(self, before: float) -> None:
        """Drop the poses older than `before`, except for the newest of them."""
        while len(self._poses) > 2 and self._poses[1][0] <= before:
            self._poses.popleft()
            self._inflation.popleft()

    def track_since(self, start: float) -> Track:
        """Return the odometry since `start`, with one pose before it."""
        count = 0
        for t, *_ in reversed(self._poses):
            count += 1
            if t <= start:
                break
        first = len(self._poses) - count
        rows = np.array(list(itertools.islice(self._poses, first, None)))
        step_inflation = np.array(list(itertools.islice(self._inflation, first + 1, None)))
        t, x, y, heading = rows.T
        return Track(t, x, y, heading, step_inflation=step_inflation)

    def segment_between(self, start: float, end: float, noise: StepNoise) -> SegmentedOdometry:
        """Return the odometry between two times as one segment."""
        return segment_odometry(self.track_since(start), np.array([start, end]), noise)
