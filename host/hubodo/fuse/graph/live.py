"""The factor graph live: a window over the last minute, with the batch's factors and solver."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.errors import InputError
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import Graph
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import NAMES
from hubodo.fuse.graph.factors.factor import Factor
from hubodo.fuse.graph.factors.heading import Headings
from hubodo.fuse.graph.fixes import Fixes, one_fix
from hubodo.fuse.graph.graph import fuse_graph
from hubodo.fuse.graph.measurement import Measurement, gathered
from hubodo.fuse.graph.steps import CutPath, OdometryPath, cut_path
from hubodo.fuse.graph.track import GraphTrack
from hubodo.fuse.graph.window import Window
from hubodo.fuse.projection import LocalFrame

_SAME = 1e-6
"""s; measurements closer together than this are of one time."""
_FEWEST = 3
"""Fixes and odometry poses from which a start is worth trying."""
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
    """lag: s of poses that are still moved: long enough for a fix to be judged by those after it. look_back:
    s of measurements a start looks at, begun every `retry` s and good when the heading's 1 sigma is below
    `heading`, rad (9 deg: within it Gauss-Newton is sure to converge). patience: s that a fix may come after
    the odometry of its time: two epochs of a slow receiver. lost: s of nothing but refused fixes, after which
    the graph starts anew: longer than any street canyon misleads a receiver alike."""

    lag: float = 60.0
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
    """A sample that waits for the odometry to reach its time."""

    t: float
    sample: Fixes | Measurement


@dataclass(slots=True)
class _Found:
    """What a start found, and what became of it. growth: times which the fixes' sigma is widened; fix_t: s of
    the newest fix that counted."""

    window: Window
    frame: LocalFrame
    growth: float
    fix_t: float


class LiveGraph:
    """Feed `odometry`, `fix`, `heading` and `measured` in any order of kinds; `state` is the newest pose,
    None before the start.

    Begins when a batch solution over the last measurements tells the heading; its factors are the window's
    first.
    """

    def __init__(self, config: GraphConfig | None = None, limits: LiveLimits | None = None) -> None:
        self._config = config or GraphConfig()
        self._limits = limits or LiveLimits()
        self._odometry: deque[tuple[float, float, float, float]] = deque()
        self._covariances: deque[Array | None] = deque()
        self._waiting: deque[_Seen] = deque()
        self._past: deque[_Seen] = deque()
        self._warnings: list[str] = []
        self._next_try = -math.inf
        self._found: _Found | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each thing worth knowing so far."""
        return tuple(self._warnings)

    def odometry(
        self, t: float, x: float, y: float, heading: float, covariance: Array | None = None
    ) -> Reception:
        """A pose of the odometry; covariance: (3, 3) of what is random since the one before, as
        OdometryPath's."""
        if not all(math.isfinite(v) for v in (t, x, y, heading)):
            return Reception.IMPOSSIBLE
        if self._odometry and t <= self._odometry[-1][0]:
            return Reception.LATE
        self._odometry.append((t, x, y, heading))
        self._covariances.append(covariance)
        if self._found is None:
            self._start(t)
        else:
            self._take_waiting(self._found, t)
        oldest = t - self._limits.look_back
        if self._found is not None:
            oldest = min(oldest, float(self._found.window.state_t[-1]))
        while len(self._odometry) > 2 and self._odometry[1][0] <= oldest:
            self._odometry.popleft()
            self._covariances.popleft()
        while self._past and self._past[0].t < t - self._limits.look_back:
            self._past.popleft()
        return Reception.STARTING if self._found is None else Reception.TAKEN

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

    def measured(self, t: float, sample: Measurement) -> Reception:
        """One sample of any other kind, at time t."""
        return self._measured(t, sample) if math.isfinite(t) else Reception.IMPOSSIBLE

    def state(self) -> LiveState | None:
        """The newest pose: that of the graph, carried on by the odometry since."""
        if self._found is None:
            return None
        window = self._found.window
        t, pose, covariance = float(window.state_t[-1]), window.poses[-1], window.covariance
        newest = self._odometry[-1][0]
        if newest > t:
            pose, covariance = _carried(window, self._cut(t, newest))
            t = newest
        sigmas = np.sqrt(np.maximum(np.diag(window.constants_covariance), 0.0))
        constants = {
            name: Quantity(float(value), float(sigma))
            for name, value, sigma in zip(NAMES, window.constants, sigmas, strict=True)
        }
        x, y, heading = pose.tolist()
        return LiveState(t, x, y, heading, covariance, self._found.fix_t, constants, self._found.frame)

    def _measured(self, t: float, sample: Fixes | Measurement) -> Reception:
        if self._found is not None and t <= self._found.window.state_t[-1] + _SAME:
            return Reception.LATE
        place = len(self._waiting)
        while place > 0 and self._waiting[place - 1].t > t:
            place -= 1
        self._waiting.insert(place, _Seen(t, sample))
        if self._found is None:
            return Reception.STARTING
        self._take_waiting(self._found, self._odometry[-1][0])
        return Reception.TAKEN

    def _start(self, t: float) -> None:
        """Try a batch over what is there; take its factors if it tells the heading."""
        while self._waiting and self._waiting[0].t <= t:
            self._past.append(self._waiting.popleft())
        if t < self._next_try or len(self._odometry) < _FEWEST:
            return
        self._next_try = t + self._limits.retry
        fixes = [seen.sample for seen in self._past if isinstance(seen.sample, Fixes)]
        if len(fixes) < _FEWEST:
            return
        kinds: dict[type[Measurement], list[Measurement]] = {}
        for seen in self._past:
            if not isinstance(seen.sample, Fixes):
                kinds.setdefault(type(seen.sample), []).append(seen.sample)
        others = [gathered(samples) for samples in kinds.values()]
        config = replace(self._config, search_delay=False)
        try:
            batch = fuse_graph(self._path(-math.inf), _increasing(gathered(fixes)), None, config, others)
        except InputError as error:
            self._warnings.append(str(error))
            return
        sigma = math.sqrt(float(batch.solution.covariance[-1, 2, 2]))
        if batch.frame is None or sigma > self._limits.heading:
            return
        self._warnings += batch.warnings
        self._found = _begun(batch, batch.frame, float(batch.state_t[-1]) - self._limits.lag)

    def _take_waiting(self, found: _Found, newest: float) -> None:
        while self._waiting and self._waiting[0].t <= newest:
            t, together = self._waiting[0].t, []
            while self._waiting and self._waiting[0].t <= t + _SAME:
                together.append(self._waiting.popleft())
            self._past += together
            if t > found.window.state_t[-1] + _SAME:
                self._extend(found, t, [seen.sample for seen in together])
            if self._found is None:
                return
        # Where nothing is measured the chain goes on by itself, late enough for what is still under way.
        knot = self._config.knot
        while newest - found.window.state_t[-1] > self._limits.patience + knot:
            self._extend(found, float(found.window.state_t[-1]) + knot, [])

    def _extend(self, found: _Found, t: float, samples: list[Fixes | Measurement]) -> None:
        """A pose at t with what was measured there, and the window solved and moved on."""
        knot = self._config.knot
        while t - found.window.state_t[-1] > _STRETCH * knot:
            self._extend(found, float(found.window.state_t[-1]) + knot, [])
        window = found.window
        cut = self._cut(float(window.state_t[-1]), t)
        pose, _ = _carried(window, cut)
        factors: list[Factor] = [BetweenFactors.of(cut.steps)]
        weight = None
        for sample in samples:
            if isinstance(sample, Fixes):
                fix = one_fix(sample, found.frame, self._config, found.growth).factors(cut, self._config)
                item = fix.linear(np.stack([window.poses[-1], pose]), window.constants)
                weight = float(fix.loss.weight(item.squares)[0])
                factors.append(fix)
            elif (factor := sample.factors(cut, self._config)) is not None:
                factors.append(factor)
        window = window.extended(Graph(tuple(factors)), t, pose)
        try:
            found.window = window.solved().since(t - self._limits.lag)
        except InputError as error:
            self._warnings.append(f"{error}; the graph starts anew at {t:.1f} s")
            self._found = None
            return
        if weight is not None:
            self._watch(found, t, weight)

    def _watch(self, found: _Found, t: float, weight: float) -> None:
        """Fixes that are refused one after the other are worth a word, and at last a new start."""
        if weight > 0.0:
            if t - found.fix_t > _NOTICED:
                self._warnings.append(f"gnss: fixes count again from t = {t:.1f} s")
            found.fix_t = t
        elif t - found.fix_t > self._limits.lost:
            self._warnings.append(
                f"gnss: refused since t = {found.fix_t:.1f} s; the graph starts anew at {t:.1f} s"
            )
            self._found, self._next_try = None, -math.inf
        elif not self._warnings or f"after t = {found.fix_t:.1f} s" not in self._warnings[-1]:
            self._warnings.append(
                f"gnss: a fix at t = {t:.1f} s jumped; fixes after t = {found.fix_t:.1f} s are refused"
            )

    def _cut(self, begin: float, end: float) -> CutPath:
        return cut_path(self._path(begin), np.array([begin, end]), self._config.noise)

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


def _begun(batch: GraphTrack, frame: LocalFrame, oldest: float) -> _Found:
    """A batch solution as the first window."""
    found = batch.solution
    window = Window(
        batch.graph,
        batch.state_t,
        found.poses,
        found.constants,
        found.covariance[-1],
        found.constants_covariance,
    )
    return _Found(window.since(oldest), frame, batch.sigma_growth, float(batch.fix_t[-1]))


def _increasing(fixes: Fixes) -> Fixes:
    """Those whose time exceeds all before."""
    t = fixes.t
    keep = t > np.append(-np.inf, np.maximum.accumulate(t)[:-1])
    assert fixes.sigma is not None
    return Fixes(t[keep], fixes.latitude_deg[keep], fixes.longitude_deg[keep], fixes.sigma[keep])


def _carried(window: Window, cut: CutPath) -> tuple[Array, Array]:
    """The window's newest pose and its covariance at the end of a stretch of odometry."""
    pose, steps = window.poses[-1], cut.steps
    moved = complex(steps.moves(window.constants).sum())
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    east, north = cos * moved.real - sin * moved.imag, sin * moved.real + cos * moved.imag
    step = np.array([[1.0, 0.0, -north], [0.0, 1.0, east], [0.0, 0.0, 1.0]])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    grown = step @ window.covariance @ step.T + turn @ steps.covariance[0] @ turn.T
    return pose + np.array([east, north, float(steps.turns(window.constants)[0])]), grown
