"""The live factor graph over a window of the last minute, with the factors and the solver of the batch."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.errors import InputError
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import CONSTANT_NAMES
from hubodo.fuse.graph.factors.factor import FactorGroup, LinearisedFactors, SensorSamples
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.fixes import Fixes, localise_fix
from hubodo.fuse.graph.initialisation import RunningGraph, start_graph
from hubodo.fuse.graph.odometry_steps import OdometryBuffer, SegmentedOdometry
from hubodo.fuse.graph.window import PoseWindow
from hubodo.fuse.projection import LocalFrame

_SAME_TIME_TOLERANCE = 1e-6
"""s; measurements closer together belong to one pose."""
_MIN_REPORTED_GAP = 2.0
"""s without a used fix, after which the next one is reported."""
_MAX_SPACING_RATIO = 1.5
"""Multiple of `max_pose_spacing` from which a segment gets poses of its own."""


class SampleStatus(Enum):
    """Result of adding a measurement to the live graph."""

    ACCEPTED = "in the graph, or waiting for the odometry to reach its time"
    INITIALISING = "buffered until the fixes determine the heading"
    TOO_LATE = "older than the newest pose of the graph; dropped"
    INVALID = "not on Earth, or not finite; dropped"


@dataclass(frozen=True, slots=True)
class LiveLimits:
    """Times and limits of a live graph.

    Attributes
    ----------
    lag : s of newest poses that are still estimated: long enough to judge a fix by those after it.
    start_history : s of measurements used for a start.
    retry_interval : s between attempts to start.
    max_heading_sigma : rad, 1 sigma of the heading with which the graph starts; at 9 deg Gauss-Newton
        converges.
    max_fix_latency : s by which a fix may arrive after the odometry of its time: two epochs of a slow
        receiver.
    restart_after : s of rejected fixes only, after which the graph restarts: longer than in any street
        canyon.
    """

    lag: float = 60.0
    start_history: float = 120.0
    retry_interval: float = 2.0
    max_heading_sigma: float = 0.15
    max_fix_latency: float = 2.0
    restart_after: float = 60.0


@dataclass(frozen=True, slots=True)
class LiveState:
    """Pose at the time of the newest odometry.

    Attributes
    ----------
    t : s.
    x, y : m east and north of `frame`.
    heading : rad.
    covariance : (3, 3) of x, y, heading.
    last_fix_t : s, time of the newest fix that was used.
    constants : estimates by name, as in GraphResult.
    frame : the map frame.
    """

    t: float
    x: float
    y: float
    heading: float
    covariance: Array
    last_fix_t: float
    constants: dict[str, Quantity]
    frame: LocalFrame


@dataclass(frozen=True, slots=True)
class _PendingSample:
    """A sample that waits for odometry of its time."""

    t: float
    sample: Fixes | SensorSamples


class LiveGraph:
    """Factor graph over the newest poses, fed one measurement at a time in any order of kinds.

    It starts when a batch solution over the last measurements determines the heading; the factors of that
    solution are the first of the window.
    """

    def __init__(self, config: GraphConfig | None = None, limits: LiveLimits | None = None) -> None:
        self._config = config or GraphConfig()
        self._limits = limits or LiveLimits()
        self._odometry = OdometryBuffer()
        self._pending: deque[_PendingSample] = deque()
        self._history: deque[_PendingSample] = deque()
        self._warnings: list[str] = []
        self._next_start_t = -math.inf
        self._running: RunningGraph | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the warnings so far, one line each."""
        return tuple(self._warnings)

    def add_odometry(
        self, t: float, x: float, y: float, heading: float, step_inflation: float = 0.0
    ) -> SampleStatus:
        """Add an odometry pose; step_inflation: m², of the step that ends there, as in Track."""
        if not all(math.isfinite(v) for v in (t, x, y, heading)):
            return SampleStatus.INVALID
        if t <= self._odometry.newest_t:
            return SampleStatus.TOO_LATE
        self._odometry.add_pose((t, x, y, heading), step_inflation)
        if self._running is None:
            self._try_start(t)
        else:
            self._advance(self._running, t)
        oldest = t - self._limits.start_history
        if self._running is not None:
            oldest = min(oldest, float(self._running.window.pose_t[-1]))
        self._odometry.drop_before(oldest)
        while self._history and self._history[0].t < t - self._limits.start_history:
            self._history.popleft()
        return SampleStatus.INITIALISING if self._running is None else SampleStatus.ACCEPTED

    def add_fix(
        self, t: float, latitude_deg: float, longitude_deg: float, sigma: float | None = None
    ) -> SampleStatus:
        """Add a GNSS fix; sigma: m, None where the receiver declares none."""
        finite = all(math.isfinite(v) for v in (t, latitude_deg, longitude_deg))
        if not finite or abs(latitude_deg) > 90.0 or abs(longitude_deg) > 360.0:
            return SampleStatus.INVALID
        declared_sigma = math.nan if sigma is None else sigma
        return self._insert_sample(
            t, Fixes(*(np.array([v]) for v in (t, latitude_deg, longitude_deg, declared_sigma)))
        )

    def add_heading(self, t: float, heading: float, sigma: float | None = None) -> SampleStatus:
        """Add a heading, rad anticlockwise from east."""
        if not (math.isfinite(t) and math.isfinite(heading)):
            return SampleStatus.INVALID
        declared_sigma = math.nan if sigma is None else sigma
        return self._insert_sample(t, Headings(*(np.array([v]) for v in (t, heading, declared_sigma))))

    def add_samples(self, t: float, sample: SensorSamples) -> SampleStatus:
        """Add one sample of any other kind, at time t."""
        return self._insert_sample(t, sample) if math.isfinite(t) else SampleStatus.INVALID

    def state(self) -> LiveState | None:
        """Return the newest pose of the graph, propagated by odometry since; None before the start."""
        if self._running is None:
            return None
        window = self._running.window
        t, pose, covariance = float(window.pose_t[-1]), window.poses[-1], window.covariance
        if self._odometry.newest_t > t:
            pose, covariance = _propagate(
                window, self._odometry.segment_between(t, self._odometry.newest_t, self._running.noise)
            )
            t = self._odometry.newest_t
        sigmas = np.sqrt(np.maximum(np.diag(window.constants_covariance), 0.0))
        constants = {
            name: Quantity(float(value), float(sigma))
            for name, value, sigma in zip(CONSTANT_NAMES, window.constants, sigmas, strict=True)
        }
        x, y, heading = pose.tolist()
        return LiveState(
            t, x, y, heading, covariance, self._running.last_fix_t, constants, self._running.frame
        )

    def _insert_sample(self, t: float, sample: Fixes | SensorSamples) -> SampleStatus:
        """Insert a sample by time, and process all samples up to the newest odometry."""
        if self._running is not None and t <= self._running.window.pose_t[-1] + _SAME_TIME_TOLERANCE:
            return SampleStatus.TOO_LATE
        position = len(self._pending)
        while position > 0 and self._pending[position - 1].t > t:
            position -= 1
        self._pending.insert(position, _PendingSample(t, sample))
        if self._running is None:
            return SampleStatus.INITIALISING
        self._advance(self._running, self._odometry.newest_t)
        return SampleStatus.ACCEPTED

    def _try_start(self, t: float) -> None:
        """Solve a batch over the history and start with its factors if it determines the heading."""
        while self._pending and self._pending[0].t <= t:
            self._history.append(self._pending.popleft())
        if t < self._next_start_t or len(self._odometry) < 2:
            return
        self._next_start_t = t + self._limits.retry_interval
        samples = [pending.sample for pending in self._history]
        try:
            running = start_graph(
                self._odometry.track_since(-math.inf), samples, self._config, self._limits.max_heading_sigma
            )
        except InputError as error:
            self._warnings.append(str(error))
            return
        if running is None:
            return
        self._warnings += running.warnings
        running.window = running.window.without_poses_before(
            float(running.window.pose_t[-1]) - self._limits.lag
        )
        self._running = running

    def _advance(self, running: RunningGraph, newest: float) -> None:
        """Extend the graph to the newest odometry, with the samples that waited for it."""
        try:
            self._process_pending(running, newest)
        except InputError as error:
            self._warnings.append(f"{error}; the graph restarts at {newest:.1f} s")
            self._running = None

    def _process_pending(self, running: RunningGraph, newest: float) -> None:
        """Add poses for pending samples up to `newest`, then poses without samples at the maximum spacing."""
        while self._pending and self._pending[0].t <= newest:
            first_t = self._pending[0].t
            simultaneous: dict[type[Fixes | SensorSamples], Fixes | SensorSamples] = {}
            while self._pending and self._pending[0].t <= first_t + _SAME_TIME_TOLERANCE:
                self._history.append(self._pending.popleft())
                simultaneous.setdefault(type(self._history[-1].sample), self._history[-1].sample)
            t = self._history[-1].t
            if t > running.window.pose_t[-1] + _SAME_TIME_TOLERANCE:
                self._add_pose(running, t, list(simultaneous.values()))
            if self._running is None:
                return
        # Without measurements poses follow at the maximum spacing, late enough for delayed samples.
        spacing = self._config.max_pose_spacing
        while newest - running.window.pose_t[-1] > self._limits.max_fix_latency + spacing:
            self._add_pose(running, float(running.window.pose_t[-1]) + spacing, [])

    def _add_pose(self, running: RunningGraph, t: float, samples: list[Fixes | SensorSamples]) -> None:
        """Add a pose at t with the samples measured there, solve the window and move it on."""
        spacing = self._config.max_pose_spacing
        while t - running.window.pose_t[-1] > _MAX_SPACING_RATIO * spacing:
            self._add_pose(running, float(running.window.pose_t[-1]) + spacing, [])
        window = running.window
        segment = self._odometry.segment_between(float(window.pose_t[-1]), t, running.noise)
        pose, covariance = _propagate(window, segment)
        factors: list[FactorGroup] = [BetweenFactors.from_steps(segment.steps)]
        weight = None
        for sample in samples:
            if isinstance(sample, Fixes):
                local_fix = localise_fix(sample, running.frame, self._config, running.sigma_growth)
                fix_factors = local_fix.build_factors(segment, self._config)
                linearised = fix_factors.linearise(np.stack([window.poses[-1], pose]), window.constants)
                weight = float(fix_factors.loss.weight(linearised.squared_norms)[0])
                if weight == 0.0:
                    # The fix may be off by the error of the odometry rather than its own.
                    pose, nis = _update_with_fix(pose, covariance, linearised)
                    weight = float(fix_factors.loss.weight(np.array([nis]))[0])
                factors.append(fix_factors)
            elif (factor := sample.build_factors(segment, self._config)) is not None:
                factors.append(factor)
        window = window.with_pose(FactorGraph(tuple(factors)), t, pose)
        running.window = window.with_solution().without_poses_before(t - self._limits.lag)
        if weight is not None:
            self._monitor_fixes(running, t, weight)

    def _monitor_fixes(self, running: RunningGraph, t: float, weight: float) -> None:
        """Report rejected fixes, and restart the graph when they have been rejected for too long."""
        if weight > 0.0:
            if t - running.last_fix_t > _MIN_REPORTED_GAP:
                self._warnings.append(f"gnss: fixes are used again from t = {t:.1f} s")
            running.last_fix_t = t
        elif t - running.last_fix_t > self._limits.restart_after:
            self._warnings.append(
                f"gnss: fixes rejected since t = {running.last_fix_t:.1f} s; the graph restarts at {t:.1f} s"
            )
            self._running, self._next_start_t = None, -math.inf
        elif not self._warnings or f"after t = {running.last_fix_t:.1f} s" not in self._warnings[-1]:
            self._warnings.append(
                f"gnss: a fix at t = {t:.1f} s jumped; "
                f"fixes after t = {running.last_fix_t:.1f} s are rejected"
            )


def _update_with_fix(pose: Array, covariance: Array, fix: LinearisedFactors) -> tuple[Array, float]:
    """Return an odometry pose, updated by a fix, and the fix's normalised innovation squared."""
    jacobian, residual = fix.pose_jacobian[0], fix.residual[0]
    innovation = jacobian @ covariance @ jacobian.T + np.eye(2)
    weighted = np.linalg.solve(innovation, residual)
    return pose - covariance @ jacobian.T @ weighted, float(residual @ weighted)


def _propagate(window: PoseWindow, segment: SegmentedOdometry) -> tuple[Array, Array]:
    """Return the window's newest pose and its covariance, propagated over a segment of odometry."""
    pose, steps = window.poses[-1], segment.steps
    displacement = complex(steps.correct_displacements(window.constants).sum())
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    east, north = (
        cos * displacement.real - sin * displacement.imag,
        sin * displacement.real + cos * displacement.imag,
    )
    rotation_jacobian = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    propagated = (
        rotation_jacobian @ window.covariance @ rotation_jacobian.T
        + rotation @ steps.covariance[0] @ rotation.T
    )
    return pose + np.array([east, north, float(steps.correct_turns(window.constants)[0])]), propagated
