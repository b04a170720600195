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
from hubodo.fuse.graph.beginning import Underway, begin
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import Graph
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import NAMES
from hubodo.fuse.graph.factors.factor import Factor, Linear, SensorSamples
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.fixes import Fixes, one_fix
from hubodo.fuse.graph.steps import CutPath, Trail
from hubodo.fuse.graph.window import PoseWindow
from hubodo.fuse.projection import LocalFrame

_SAME = 1e-6
"""s; measurements closer together than this are of one time."""
_NOTICED = 2.0
"""s without a fix that counts, after which the next one is worth a word."""
_STRETCH = 1.5
"""Knots; a stretch longer than this gets poses of its own."""


class Reception(Enum):
    """What became of a measurement."""

    TAKEN = "in the graph, or waiting for the odometry to reach its time"
    STARTING = "kept until the fixes tell the heading"
    LATE = "older than the newest pose of the graph; left out"
    IMPOSSIBLE = "no place on Earth, or not finite; left out"


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
    look_back: float = 120.0
    retry: float = 2.0
    heading: float = 0.15
    patience: float = 2.0
    lost: float = 60.0


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
    fix_t: float
    constants: dict[str, Quantity]
    frame: LocalFrame


@dataclass(frozen=True, slots=True)
class _Seen:
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
        self._trail = Trail()
        self._waiting: deque[_Seen] = deque()
        self._past: deque[_Seen] = deque()
        self._warnings: list[str] = []
        self._next_try = -math.inf
        self._underway: Underway | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each thing worth knowing so far."""
        return tuple(self._warnings)

    def odometry(self, t: float, x: float, y: float, heading: float, loose: float = 0.0) -> Reception:
        """A pose of the odometry; loose: m², of the way since the one before, as Track's."""
        if not all(math.isfinite(v) for v in (t, x, y, heading)):
            return Reception.IMPOSSIBLE
        if t <= self._trail.newest:
            return Reception.LATE
        self._trail.add((t, x, y, heading), loose)
        if self._underway is None:
            self._start(t)
        else:
            self._catch_up(self._underway, t)
        oldest = t - self._limits.look_back
        if self._underway is not None:
            oldest = min(oldest, float(self._underway.window.state_t[-1]))
        self._trail.forget(oldest)
        while self._past and self._past[0].t < t - self._limits.look_back:
            self._past.popleft()
        return Reception.STARTING if self._underway is None else Reception.TAKEN

    def fix(
        self, t: float, latitude_deg: float, longitude_deg: float, sigma: float | None = None
    ) -> Reception:
        """A GNSS fix; sigma: m, None where the receiver did not say."""
        finite = all(math.isfinite(v) for v in (t, latitude_deg, longitude_deg))
        if not finite or abs(latitude_deg) > 90.0 or abs(longitude_deg) > 360.0:
            return Reception.IMPOSSIBLE
        own = math.nan if sigma is None else sigma
        return self._measured(t, Fixes(*(np.array([v]) for v in (t, latitude_deg, longitude_deg, own))))

    def heading(self, t: float, heading: float, sigma: float | None = None) -> Reception:
        """A heading, rad anticlockwise from east."""
        if not (math.isfinite(t) and math.isfinite(heading)):
            return Reception.IMPOSSIBLE
        own = math.nan if sigma is None else sigma
        return self._measured(t, Headings(*(np.array([v]) for v in (t, heading, own))))

    def measured(self, t: float, sample: SensorSamples) -> Reception:
        """One sample of any other kind, at time t."""
        return self._measured(t, sample) if math.isfinite(t) else Reception.IMPOSSIBLE

    def state(self) -> LiveState | None:
        """The newest pose: that of the graph, carried on by the odometry since."""
        if self._underway is None:
            return None
        window = self._underway.window
        t, pose, covariance = float(window.state_t[-1]), window.poses[-1], window.covariance
        if self._trail.newest > t:
            pose, covariance = _carried(window, self._trail.cut(t, self._trail.newest, self._underway.noise))
            t = self._trail.newest
        sigmas = np.sqrt(np.maximum(np.diag(window.constants_covariance), 0.0))
        constants = {
            name: Quantity(float(value), float(sigma))
            for name, value, sigma in zip(NAMES, window.constants, sigmas, strict=True)
        }
        x, y, heading = pose.tolist()
        return LiveState(t, x, y, heading, covariance, self._underway.fix_t, constants, self._underway.frame)

    def _measured(self, t: float, sample: Fixes | SensorSamples) -> Reception:
        if self._underway is not None and t <= self._underway.window.state_t[-1] + _SAME:
            return Reception.LATE
        place = len(self._waiting)
        while place > 0 and self._waiting[place - 1].t > t:
            place -= 1
        self._waiting.insert(place, _Seen(t, sample))
        if self._underway is None:
            return Reception.STARTING
        self._catch_up(self._underway, self._trail.newest)
        return Reception.TAKEN

    def _start(self, t: float) -> None:
        """Try a batch over what is there; take its factors if it tells the heading."""
        while self._waiting and self._waiting[0].t <= t:
            self._past.append(self._waiting.popleft())
        if t < self._next_try or len(self._trail) < 2:
            return
        self._next_try = t + self._limits.retry
        samples = [seen.sample for seen in self._past]
        try:
            found = begin(self._trail.path(-math.inf), samples, self._config, self._limits.heading)
        except InputError as error:
            self._warnings.append(str(error))
            return
        if found is None:
            return
        self._warnings += found.warnings
        found.window = found.window.since(float(found.window.state_t[-1]) - self._limits.lag)
        self._underway = found

    def _catch_up(self, underway: Underway, newest: float) -> None:
        """The graph up to the newest odometry, and what waited for it."""
        try:
            self._take_waiting(underway, newest)
        except InputError as error:
            self._warnings.append(f"{error}; the graph starts anew at {newest:.1f} s")
            self._underway = None

    def _take_waiting(self, underway: Underway, newest: float) -> None:
        while self._waiting and self._waiting[0].t <= newest:
            first = self._waiting[0].t
            together: dict[type[Fixes | SensorSamples], Fixes | SensorSamples] = {}
            while self._waiting and self._waiting[0].t <= first + _SAME:
                self._past.append(self._waiting.popleft())
                together.setdefault(type(self._past[-1].sample), self._past[-1].sample)
            t = self._past[-1].t
            if t > underway.window.state_t[-1] + _SAME:
                self._extend(underway, t, list(together.values()))
            if self._underway is None:
                return
        # Where nothing is measured the chain goes on by itself, late enough for what is still under way.
        knot = self._config.knot
        while newest - underway.window.state_t[-1] > self._limits.patience + knot:
            self._extend(underway, float(underway.window.state_t[-1]) + knot, [])

    def _extend(self, underway: Underway, t: float, samples: list[Fixes | SensorSamples]) -> None:
        """A pose at t with what was measured there, and the window solved and moved on."""
        knot = self._config.knot
        while t - underway.window.state_t[-1] > _STRETCH * knot:
            self._extend(underway, float(underway.window.state_t[-1]) + knot, [])
        window = underway.window
        cut = self._trail.cut(float(window.state_t[-1]), t, underway.noise)
        pose, covariance = _carried(window, cut)
        factors: list[Factor] = [BetweenFactors.of(cut.steps)]
        weight = None
        for sample in samples:
            if isinstance(sample, Fixes):
                local = one_fix(sample, underway.frame, self._config, underway.growth)
                fix = local.factors(cut, self._config)
                item = fix.linear(np.stack([window.poses[-1], pose]), window.constants)
                weight = float(fix.loss.weight(item.squares)[0])
                if weight == 0.0:
                    # Beyond what a receiver errs by, but not beyond what the odometry may have.
                    pose, nis = _met(pose, covariance, item)
                    weight = float(fix.loss.weight(np.array([nis]))[0])
                factors.append(fix)
            elif (factor := sample.factors(cut, self._config)) is not None:
                factors.append(factor)
        window = window.extended(Graph(tuple(factors)), t, pose)
        underway.window = window.solved().since(t - self._limits.lag)
        if weight is not None:
            self._watch(underway, t, weight)

    def _watch(self, underway: Underway, t: float, weight: float) -> None:
        """Fixes that are refused one after the other are worth a word, and at last a new start."""
        if weight > 0.0:
            if t - underway.fix_t > _NOTICED:
                self._warnings.append(f"gnss: fixes count again from t = {t:.1f} s")
            underway.fix_t = t
        elif t - underway.fix_t > self._limits.lost:
            self._warnings.append(
                f"gnss: refused since t = {underway.fix_t:.1f} s; the graph starts anew at {t:.1f} s"
            )
            self._underway, self._next_try = None, -math.inf
        elif not self._warnings or f"after t = {underway.fix_t:.1f} s" not in self._warnings[-1]:
            self._warnings.append(
                f"gnss: a fix at t = {t:.1f} s jumped; fixes after t = {underway.fix_t:.1f} s are refused"
            )


def _met(pose: Array, covariance: Array, fix: Linear) -> tuple[Array, float]:
    """The pose of an odometry of this covariance, (3, 3), with a fix; the squared innovation in sigmas."""
    h, residual = fix.by_state[0], fix.residual[0]
    innovation = h @ covariance @ h.T + np.eye(2)
    weighted = np.linalg.solve(innovation, residual)
    return pose - covariance @ h.T @ weighted, float(residual @ weighted)


def _carried(window: PoseWindow, cut: CutPath) -> tuple[Array, Array]:
    """The window's newest pose and its covariance at the end of a stretch of odometry."""
    pose, steps = window.poses[-1], cut.steps
    moved = complex(steps.moves(window.constants).sum())
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    east, north = cos * moved.real - sin * moved.imag, sin * moved.real + cos * moved.imag
    step = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    grown = step @ window.covariance @ step.T + turn @ steps.covariance[0] @ turn.T
    return pose + np.array([east, north, float(steps.turns(window.constants)[0])]), grown
