"""The factor graph live: a window of the last seconds in GTSAM's incremental fixed-lag smoother, with the
batch's factors."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.errors import InputError
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.between import BetweenFactors, whitening
from hubodo.fuse.graph.factors.constants import NAMES
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.fixes import Fixes, Headings
from hubodo.fuse.graph.graph import GraphTrack, fuse_graph
from hubodo.fuse.graph.gtsam_factors import (
    CONSTANTS_KEY,
    as_gtsam,
    gtsam_graph,
    gtsam_values,
    load_gtsam,
    pose_array,
)
from hubodo.fuse.graph.steps import CutPath, OdometryPath, cut_path
from hubodo.fuse.projection import LocalFrame

_MOVED = 0.05


class Outcome(Enum):
    """What became of a measurement."""

    TAKEN = "in the graph, or waiting for the odometry to reach its time"
    STARTING = "kept until the fixes tell the heading"
    LATE = "older than the newest pose of the graph; left out"
    IMPOSSIBLE = "no place on Earth, or not finite; left out"


@dataclass(frozen=True, slots=True)
class LiveLimits:
    """lag: s of poses that are still moved. look_back: s of measurements a start looks at, begun every
    `retry` s and good when the heading's 1 sigma is below `heading`, rad. patience: s that a fix may
    come after the odometry of its time. lost: s of nothing but refused fixes, after which the graph
    starts anew."""

    lag: float = 20.0
    look_back: float = 120.0
    retry: float = 2.0
    heading: float = 0.15
    patience: float = 2.0
    lost: float = 60.0


@dataclass(frozen=True, slots=True)
class LiveState:
    """Pose at the newest odometry: x, y m east and north of `frame`, heading rad. covariance: (3, 3).
    fix_t: s of the newest fix that counted. constants: as GraphTrack's."""

    t: float
    x: float
    y: float
    heading: float
    covariance: Array
    fix_t: float
    constants: dict[str, Quantity]
    frame: LocalFrame


@dataclass(frozen=True, slots=True)
class _Seen:
    """A measurement that waits: values are latitude, longitude, sigma of a fix, or heading, sigma."""

    t: float
    is_fix: bool
    values: tuple[float, ...]


class LiveGraph:
    """Feed `odometry`, `fix` and `heading` in any order of kinds; `state` is the newest pose, None before
    the start.

    Begins when a batch solution over the last measurements tells the heading; its factors are the window's
    first. Needs GTSAM: ConfigError otherwise.
    """

    def __init__(self, config: GraphConfig | None = None, limits: LiveLimits | None = None) -> None:
        self._gtsam = load_gtsam()
        self._config = config or GraphConfig()
        self._limits = limits or LiveLimits()
        self._odometry: deque[tuple[float, float, float, float]] = deque()
        self._covariances: deque[Array | None] = deque()
        self._waiting: deque[_Seen] = deque()
        self._past: deque[_Seen] = deque()
        self._warnings: list[str] = []
        self._next_try = -math.inf
        self._frame: LocalFrame | None = None
        self._smoother: Any = None
        self._growth = 1.0
        self._key = 0
        self._pose_t = self._fix_t = -math.inf
        self._pose, self._constants = np.zeros(3), np.zeros(len(NAMES))
        self._covariance, self._sigmas = np.zeros((3, 3)), np.zeros(len(NAMES))

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each thing worth knowing so far."""
        return tuple(self._warnings)

    def odometry(
        self, t: float, x: float, y: float, heading: float, covariance: Array | None = None
    ) -> Outcome:
        """A pose of the odometry; covariance: (3, 3) of what is random since the one before, as
        OdometryPath's."""
        if not all(math.isfinite(v) for v in (t, x, y, heading)):
            return Outcome.IMPOSSIBLE
        if self._odometry and t <= self._odometry[-1][0]:
            return Outcome.LATE
        self._odometry.append((t, x, y, heading))
        self._covariances.append(covariance)
        if self._smoother is None:
            self._start(t)
        else:
            self._take_waiting(t)
        oldest = (
            t - self._limits.look_back
            if self._smoother is None
            else min(self._pose_t, t - self._limits.look_back)
        )
        while len(self._odometry) > 2 and self._odometry[1][0] <= oldest:
            self._odometry.popleft()
            self._covariances.popleft()
        while self._past and self._past[0].t < t - self._limits.look_back:
            self._past.popleft()
        return Outcome.STARTING if self._smoother is None else Outcome.TAKEN

    def fix(self, t: float, latitude_deg: float, longitude_deg: float, sigma: float | None = None) -> Outcome:
        """A GNSS fix; sigma: m, None where the receiver did not say."""
        finite = all(math.isfinite(v) for v in (t, latitude_deg, longitude_deg))
        if not finite or abs(latitude_deg) > 90.0 or abs(longitude_deg) > 360.0:
            return Outcome.IMPOSSIBLE
        return self._measured(
            _Seen(t, True, (latitude_deg, longitude_deg, math.nan if sigma is None else sigma))
        )

    def heading(self, t: float, heading: float, sigma: float | None = None) -> Outcome:
        """A heading, rad anticlockwise from east."""
        if not (math.isfinite(t) and math.isfinite(heading)):
            return Outcome.IMPOSSIBLE
        return self._measured(_Seen(t, False, (heading, math.nan if sigma is None else sigma)))

    def state(self) -> LiveState | None:
        """The newest pose: that of the graph, carried on by the odometry since."""
        if self._smoother is None or self._frame is None:
            return None
        t, pose, covariance = self._pose_t, self._pose, self._covariance
        newest = self._odometry[-1][0]
        if newest > t:
            cut = cut_path(self._path(t), np.array([t, newest]), self._config.noise)
            pose, covariance = _carried(pose, covariance, cut, self._constants)
            t = newest
        constants = {
            name: Quantity(float(value), float(sigma))
            for name, value, sigma in zip(NAMES, self._constants, self._sigmas, strict=True)
        }
        x, y, heading = pose.tolist()
        return LiveState(t, x, y, heading, covariance, self._fix_t, constants, self._frame)

    def _measured(self, seen: _Seen) -> Outcome:
        if self._smoother is not None and seen.t <= self._pose_t + 1e-6:
            return Outcome.LATE
        if self._waiting and seen.t < self._waiting[-1].t:
            later = [item for item in self._waiting if item.t > seen.t]
            for _ in later:
                self._waiting.pop()
            self._waiting.extend([seen, *later])
        else:
            self._waiting.append(seen)
        if self._smoother is None:
            return Outcome.STARTING
        self._take_waiting(self._odometry[-1][0])
        return Outcome.TAKEN

    def _start(self, t: float) -> None:
        """Try a batch over what is there; take its factors if it tells the heading."""
        while self._waiting and self._waiting[0].t <= t:
            self._past.append(self._waiting.popleft())
        if t < self._next_try or len(self._odometry) < 3:
            return
        self._next_try = t + self._limits.retry
        fixes = [item for item in self._past if item.is_fix]
        if len(fixes) < 3:
            return
        columns = np.array([(item.t, *item.values) for item in fixes])
        seen = np.array([(item.t, *item.values) for item in self._past if not item.is_fix]).reshape(-1, 3)
        config = replace(self._config, search_delay=False)
        try:
            batch = fuse_graph(
                self._path(-math.inf),
                Fixes(*columns[_increasing(columns[:, 0])].T),
                Headings(*seen.T) if len(seen) > 0 else None,
                config,
            )
        except InputError as error:
            self._warnings.append(str(error))
            return
        if (
            batch.frame is None
            or math.sqrt(float(batch.solution.covariance[-1, 2, 2])) > self._limits.heading
        ):
            return
        self._take_batch(batch)

    def _take_batch(self, batch: GraphTrack) -> None:
        gtsam, solution = self._gtsam, batch.solution
        n = len(solution.poses)
        parameters = gtsam.ISAM2Params()
        # Cholesky calls the system indeterminate when millimetres of odometry meet metres of GNSS.
        parameters.setFactorization("QR")
        # Factors call back into Python: one is linearised again only where its pose has moved for good.
        parameters.setRelinearizeThreshold(_MOVED)
        parameters.relinearizeSkip = 10
        self._smoother = gtsam.IncrementalFixedLagSmoother(self._limits.lag, parameters)
        state_t = batch.state_t
        factors = gtsam_graph(gtsam, batch.graph, self._key)
        values = gtsam_values(gtsam, solution.poses, solution.constants, self._key)
        stamps = {self._key + k: float(t) for k, t in enumerate(state_t)}
        stamps[CONSTANTS_KEY] = float(state_t[-1])
        self._smoother.update(factors, values, stamps)
        self._key += n - 1
        self._pose_t = float(state_t[-1])
        self._fix_t = float(batch.fix_t[-1])
        self._frame, self._growth = batch.frame, batch.sigma_growth
        self._warnings += batch.warnings
        self._read()

    def _take_waiting(self, newest: float) -> None:
        while self._waiting and self._waiting[0].t <= newest:
            seen = self._waiting.popleft()
            self._past.append(seen)
            if seen.t > self._pose_t + 1e-6:
                self._extend(seen.t, seen)
            if self._smoother is None:
                return
        # Where nothing is measured the chain goes on by itself, late enough for what is still under way.
        while newest - self._pose_t > self._limits.patience + self._config.knot:
            self._extend(self._pose_t + self._config.knot, None)

    def _extend(self, t: float, seen: _Seen | None) -> None:
        gtsam, config = self._gtsam, self._config
        while t - self._pose_t > 1.5 * config.knot:
            self._extend(self._pose_t + config.knot, None)
        cut = cut_path(self._path(self._pose_t), np.array([self._pose_t, t]), config.noise)
        between = BetweenFactors(cut.steps, whitening(cut.steps.covariance))
        pose, _ = _carried(self._pose, self._covariance, cut, self._constants)
        graph, values, key = gtsam.NonlinearFactorGraph(), gtsam.Values(), self._key + 1
        graph.add(as_gtsam(gtsam, between.linear, [self._key, key], config.losses.between, 3))
        squares = 0.0
        if seen is not None:
            factor, loss, rows = self._factor(seen, cut.velocity[1:])
            graph.add(as_gtsam(gtsam, factor.linear, [key], loss, rows))
            residual = factor.linear(pose[None], self._constants).residual[0]
            squares = float(residual @ residual) if seen.is_fix else 0.0
        values.insert(key, gtsam.Pose2(*pose))
        self._smoother.update(graph, values, {key: t, CONSTANTS_KEY: t})
        self._key, self._pose_t = key, t
        self._read()
        if seen is not None and seen.is_fix:
            self._watch(t, squares)

    def _factor(self, seen: _Seen, velocity: Array) -> tuple[PositionFactors | HeadingFactors, Any, int]:
        config, zero = self._config, np.zeros(1, np.intp)
        own = seen.values[-1]
        if not seen.is_fix:
            sigma = own if math.isfinite(own) and own > 0.0 else config.heading_sigma
            return (
                HeadingFactors(zero, np.array([seen.values[0]]), np.array([sigma])),
                config.losses.heading,
                1,
            )
        assert self._frame is not None
        sigma = own if config.declared and math.isfinite(own) and own > 0.0 else config.gnss_sigma
        x, y = self._frame.to_local(np.array([seen.values[0]]), np.array([seen.values[1]]))
        place = np.nan_to_num(np.column_stack([x, y]), posinf=1e7, neginf=-1e7)
        factor = PositionFactors(
            zero, place, np.array([max(sigma, 0.005) * self._growth]), velocity, config.antenna
        )
        return factor, config.losses.position, 2

    def _watch(self, t: float, squares: float) -> None:
        """Fixes that are refused one after the other are worth a word, and at last a new start."""
        weight = float(self._config.losses.position.weight(np.array(squares)))
        if weight > 0.0:
            if t - self._fix_t > 2.0:
                self._warnings.append(f"gnss: fixes count again from t = {t:.1f} s")
            self._fix_t = t
        elif t - self._fix_t > self._limits.lost:
            self._warnings.append(
                f"gnss: refused since t = {self._fix_t:.1f} s; the graph starts anew at {t:.1f} s"
            )
            self._smoother, self._next_try = None, -math.inf
            self._key += 1
        elif not self._warnings or f"after t = {self._fix_t:.1f} s" not in self._warnings[-1]:
            self._warnings.append(
                f"gnss: a fix at t = {t:.1f} s jumped; fixes after t = {self._fix_t:.1f} s are refused"
            )

    def _read(self) -> None:
        """Pose, constants and their covariance from the smoother."""
        estimate = self._smoother.calculateEstimate()
        pose = pose_array(self._gtsam, estimate, [self._key])[0]
        pose[2] += 2.0 * math.pi * round((self._pose[2] - pose[2]) / (2.0 * math.pi))
        self._pose = pose
        self._constants = np.asarray(estimate.atVector(CONSTANTS_KEY))
        turn = np.eye(3)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        turn[:2, :2] = [[cos, -sin], [sin, cos]]
        self._covariance = turn @ self._smoother.marginalCovariance(self._key) @ turn.T
        self._sigmas = np.sqrt(np.maximum(np.diag(self._smoother.marginalCovariance(CONSTANTS_KEY)), 0.0))

    def _path(self, begin: float) -> OdometryPath:
        """The odometry since `begin`, with one pose before it."""
        start = 0
        for number in range(len(self._odometry) - 1, -1, -1):
            if self._odometry[number][0] <= begin:
                start = number
                break
        rows = np.array([self._odometry[number] for number in range(start, len(self._odometry))])
        known = [self._covariances[number] for number in range(start + 1, len(self._covariances))]
        complete = [item for item in known if item is not None]
        covariance = np.array(complete) if complete and len(complete) == len(known) else None
        t, x, y, heading = rows.T
        return OdometryPath(t, x, y, heading, covariance)


def _increasing(t: Array) -> Array:
    """Rows whose time exceeds all before."""
    return np.asarray(t > np.append(-np.inf, np.maximum.accumulate(t)[:-1]))


def _carried(pose: Array, covariance: Array, cut: CutPath, constants: Array) -> tuple[Array, Array]:
    """A pose and its covariance at the end of a stretch of odometry."""
    moved = complex(cut.steps.moves(constants).sum())
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    east, north = cos * moved.real - sin * moved.imag, sin * moved.real + cos * moved.imag
    step = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    grown = step @ covariance @ step.T + turn @ cut.steps.covariance[0] @ turn.T
    return pose + np.array([east, north, float(cut.steps.turns(constants)[0])]), grown
