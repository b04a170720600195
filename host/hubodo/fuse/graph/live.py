"""The factor graph live: a window over the last minute, with the batch's factors and solver."""

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
"""s; measurements closer together than this are of one time."""
_MIN_REPORTED_GAP = 2.0
"""s without a fix that counts, after which the next one is worth a word."""
_MAX_SPACING_RATIO = 1.5
"""Knots; a stretch longer than this gets poses of its own."""


class SampleStatus(Enum):
    """What became of a measurement."""

    ACCEPTED = "in the graph, or waiting for the odometry to reach its time"
    INITIALISING = "kept until the fixes tell the heading"
    TOO_LATE = "older than the newest pose of the graph; left out"
    INVALID = "no place on Earth, or not finite; left out"


@dataclass(frozen=True, slots=True)
class LiveLimits:
    """Times and bounds of a live graph.

    lag: s of poses that are still moved: long enough for a fix to be judged by those after it. look_back:
    s of measurements a start looks at, begun every `retry` s and good when the heading's 1 sigma is below
    `heading`, rad (9 deg: within it Gauss-Newton is sure to converge). patience: s that a fix may come
    after the odometry of its time: two epochs of a slow receiver. lost: s of nothing but refused fixes,
    after which the graph starts anew: longer than any street canyon misleads a receiver alike.
    """

    lag: float = 60.0
    start_history: float = 120.0
    retry_interval: float = 2.0
    max_heading_sigma: float = 0.15
    max_fix_latency: float = 2.0
    restart_after: float = 60.0


@dataclass(frozen=True, slots=True)
class LiveState:
    """Pose at the newest odometry.

    x, y: m east and north of `frame`; heading: rad. covariance: (3, 3). fix_t: s of the newest fix that
    counted. constants: as GraphTrack's.
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
    """A sample that waits for the odometry to reach its time."""

    t: float
    sample: Fixes | SensorSamples


class LiveGraph:
    """Feed `odometry`, `fix`, `heading` and `measured` in any order of kinds.

    `state` is the newest pose, None before the start. It begins when a batch solution over the last
    measurements tells the heading; its factors are the window's first.
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
        """One line for each thing worth knowing so far."""
        return tuple(self._warnings)

    def add_odometry(
        self, t: float, x: float, y: float, heading: float, step_inflation: float = 0.0
    ) -> SampleStatus:
        """A pose of the odometry; loose: m², of the way since the one before, as Track's."""
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
        """A GNSS fix; sigma: m, None where the receiver did not say."""
        finite = all(math.isfinite(v) for v in (t, latitude_deg, longitude_deg))
        if not finite or abs(latitude_deg) > 90.0 or abs(longitude_deg) > 360.0:
            return SampleStatus.INVALID
        own = math.nan if sigma is None else sigma
        return self._insert_sample(t, Fixes(*(np.array([v]) for v in (t, latitude_deg, longitude_deg, own))))

    def add_heading(self, t: float, heading: float, sigma: float | None = None) -> SampleStatus:
        """A heading, rad anticlockwise from east."""
        if not (math.isfinite(t) and math.isfinite(heading)):
            return SampleStatus.INVALID
        own = math.nan if sigma is None else sigma
        return self._insert_sample(t, Headings(*(np.array([v]) for v in (t, heading, own))))

    def add_samples(self, t: float, sample: SensorSamples) -> SampleStatus:
        """One sample of any other kind, at time t."""
        return self._insert_sample(t, sample) if math.isfinite(t) else SampleStatus.INVALID

    def state(self) -> LiveState | None:
        """The newest pose: that of the graph, carried on by the odometry since."""
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
        if self._running is not None and t <= self._running.window.pose_t[-1] + _SAME_TIME_TOLERANCE:
            return SampleStatus.TOO_LATE
        place = len(self._pending)
        while place > 0 and self._pending[place - 1].t > t:
            place -= 1
        self._pending.insert(place, _PendingSample(t, sample))
        if self._running is None:
            return SampleStatus.INITIALISING
        self._advance(self._running, self._odometry.newest_t)
        return SampleStatus.ACCEPTED

    def _try_start(self, t: float) -> None:
        """Try a batch over what is there; take its factors if it tells the heading."""
        while self._pending and self._pending[0].t <= t:
            self._history.append(self._pending.popleft())
        if t < self._next_start_t or len(self._odometry) < 2:
            return
        self._next_start_t = t + self._limits.retry_interval
        samples = [seen.sample for seen in self._history]
        try:
            found = start_graph(
                self._odometry.track_since(-math.inf), samples, self._config, self._limits.max_heading_sigma
            )
        except InputError as error:
            self._warnings.append(str(error))
            return
        if found is None:
            return
        self._warnings += found.warnings
        found.window = found.window.without_poses_before(float(found.window.pose_t[-1]) - self._limits.lag)
        self._running = found

    def _advance(self, underway: RunningGraph, newest: float) -> None:
        """The graph up to the newest odometry, and what waited for it."""
        try:
            self._process_pending(underway, newest)
        except InputError as error:
            self._warnings.append(f"{error}; the graph starts anew at {newest:.1f} s")
            self._running = None

    def _process_pending(self, underway: RunningGraph, newest: float) -> None:
        while self._pending and self._pending[0].t <= newest:
            first = self._pending[0].t
            together: dict[type[Fixes | SensorSamples], Fixes | SensorSamples] = {}
            while self._pending and self._pending[0].t <= first + _SAME_TIME_TOLERANCE:
                self._history.append(self._pending.popleft())
                together.setdefault(type(self._history[-1].sample), self._history[-1].sample)
            t = self._history[-1].t
            if t > underway.window.pose_t[-1] + _SAME_TIME_TOLERANCE:
                self._add_pose(underway, t, list(together.values()))
            if self._running is None:
                return
        # Where nothing is measured the chain goes on by itself, late enough for what is still under way.
        knot = self._config.max_pose_spacing
        while newest - underway.window.pose_t[-1] > self._limits.max_fix_latency + knot:
            self._add_pose(underway, float(underway.window.pose_t[-1]) + knot, [])

    def _add_pose(self, underway: RunningGraph, t: float, samples: list[Fixes | SensorSamples]) -> None:
        """A pose at t with what was measured there, and the window solved and moved on."""
        knot = self._config.max_pose_spacing
        while t - underway.window.pose_t[-1] > _MAX_SPACING_RATIO * knot:
            self._add_pose(underway, float(underway.window.pose_t[-1]) + knot, [])
        window = underway.window
        cut = self._odometry.segment_between(float(window.pose_t[-1]), t, underway.noise)
        pose, covariance = _propagate(window, cut)
        factors: list[FactorGroup] = [BetweenFactors.from_steps(cut.steps)]
        weight = None
        for sample in samples:
            if isinstance(sample, Fixes):
                local = localise_fix(sample, underway.frame, self._config, underway.sigma_growth)
                fix = local.build_factors(cut, self._config)
                item = fix.linearise(np.stack([window.poses[-1], pose]), window.constants)
                weight = float(fix.loss.weight(item.squared_norms)[0])
                if weight == 0.0:
                    # Beyond what a receiver errs by, but not beyond what the odometry may have.
                    pose, nis = _update_with_fix(pose, covariance, item)
                    weight = float(fix.loss.weight(np.array([nis]))[0])
                factors.append(fix)
            elif (factor := sample.build_factors(cut, self._config)) is not None:
                factors.append(factor)
        window = window.with_pose(FactorGraph(tuple(factors)), t, pose)
        underway.window = window.with_solution().without_poses_before(t - self._limits.lag)
        if weight is not None:
            self._monitor_fixes(underway, t, weight)

    def _monitor_fixes(self, underway: RunningGraph, t: float, weight: float) -> None:
        """Fixes that are refused one after the other are worth a word, and at last a new start."""
        if weight > 0.0:
            if t - underway.last_fix_t > _MIN_REPORTED_GAP:
                self._warnings.append(f"gnss: fixes count again from t = {t:.1f} s")
            underway.last_fix_t = t
        elif t - underway.last_fix_t > self._limits.restart_after:
            self._warnings.append(
                f"gnss: refused since t = {underway.last_fix_t:.1f} s; the graph starts anew at {t:.1f} s"
            )
            self._running, self._next_start_t = None, -math.inf
        elif not self._warnings or f"after t = {underway.last_fix_t:.1f} s" not in self._warnings[-1]:
            self._warnings.append(
                f"gnss: a fix at t = {t:.1f} s jumped; "
                f"fixes after t = {underway.last_fix_t:.1f} s are refused"
            )


def _update_with_fix(pose: Array, covariance: Array, fix: LinearisedFactors) -> tuple[Array, float]:
    """The pose of an odometry of this covariance, (3, 3), with a fix; the squared innovation in sigmas."""
    h, residual = fix.pose_jacobian[0], fix.residual[0]
    innovation = h @ covariance @ h.T + np.eye(2)
    weighted = np.linalg.solve(innovation, residual)
    return pose - covariance @ h.T @ weighted, float(residual @ weighted)


def _propagate(window: PoseWindow, cut: SegmentedOdometry) -> tuple[Array, Array]:
    """The window's newest pose and its covariance at the end of a stretch of odometry."""
    pose, steps = window.poses[-1], cut.steps
    moved = complex(steps.correct_displacements(window.constants).sum())
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    east, north = cos * moved.real - sin * moved.imag, sin * moved.real + cos * moved.imag
    step = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    grown = step @ window.covariance @ step.T + turn @ steps.covariance[0] @ turn.T
    return pose + np.array([east, north, float(steps.correct_turns(window.constants)[0])]), grown
