"""The graph of a drive and its first guess: where the poses stand, and what is tied to them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.alignment import align
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import Graph
from hubodo.fuse.graph.factors.between import BetweenFactors, Complex
from hubodo.fuse.graph.factors.constants import COUNT
from hubodo.fuse.graph.factors.factor import SensorSamples
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.factors.prior import ConstantsFactor, StartFactor
from hubodo.fuse.graph.fixes import LocalFixes
from hubodo.fuse.graph.solver import Solution
from hubodo.fuse.graph.steps import CutPath, cut_path
from hubodo.fuse.graph.track import DriveGraph
from hubodo.fuse.track import Track

_FAR_OFF = 1e4
"""m; the frame stands at the median fix, and no drive is longer than that."""
_ANY_HEADING = math.pi / math.sqrt(3.0)
"""rad; 1 sigma of a heading of which nothing is known: even over a turn."""
_HERE = 1e-3
"""m; without fixes the first pose is where the map begins."""
_SILENCE = 2.0
"""s between poses of the odometry, from which on nothing was heard of the wheels. Estimated."""


def build(
    path: Track,
    measured: Sequence[SensorSamples],
    config: GraphConfig,
    solution: Solution | None = None,
) -> DriveGraph:
    """The graph of a drive.

    It has a pose at each mark of what was measured, at both ends of the odometry and of its silences, and
    where they would be further apart than `knot`, but for a silence. solution: of a graph with the same
    poses, in place of a first guess.
    """
    marks = np.concatenate([path.t[:0], *(item.marks for item in measured)])
    marks = marks[(marks >= path.t[0]) & (marks <= path.t[-1])]
    cut = cut_path(path, _state_times(path.t, marks, config.knot), config.noise)
    factors = [factor for item in measured if (factor := item.factors(cut, config)) is not None]
    local = next((item for item in measured if isinstance(item, LocalFixes)), None)
    headings = next((factor for factor in factors if isinstance(factor, HeadingFactors)), None)
    poses, known = _first_guess(cut, local, headings, config)
    if solution is not None:
        poses = solution.poses
    start = StartFactor(np.zeros(1, np.intp), *_start(poses[0], local is not None, config))
    graph = Graph((*factors, BetweenFactors.of(cut.steps), start, prior_of(config)))
    return DriveGraph(graph, poses, cut, known)


def prior_of(config: GraphConfig) -> ConstantsFactor:
    """What is known of the constants beforehand."""
    return ConstantsFactor(np.zeros(1, np.intp), np.zeros((1, COUNT)), config.constants.array()[None])


def _first_guess(
    cut: CutPath, local: LocalFixes | None, headings: HeadingFactors | None, config: GraphConfig
) -> tuple[Array, bool]:
    """The odometry's poses (n, 3), turned to the headings and laid on the fixes.

    Besides, whether anything told the turn.
    """
    poses, known = cut.pose.copy(), config.start_heading is not None
    turn = 0.0 if config.start_heading is None else config.start_heading - poses[0, 2]
    if not known and headings is not None:
        off = np.exp(1j * (headings.heading - poses[headings.state, 2]))
        turn, known = float(np.angle(off.sum())), True
    place = np.exp(1j * turn) * (poses[:, 0] + 1j * poses[:, 1])
    if local is not None:
        laid, place, by_fixes = _laid_on(local, cut, place)
        known = known or by_fixes
        poses[:, 2] += laid
    poses[:, 2] += turn
    poses[:, 0], poses[:, 1] = place.real, place.imag
    return poses, known


def _start(pose: Array, on_map: bool, config: GraphConfig) -> tuple[Array, Array]:
    """Mean and 1 sigma of the first pose, (1, 3) each."""
    mean, sigma = pose.copy(), np.array([_FAR_OFF, _FAR_OFF, _ANY_HEADING])
    if not on_map:
        sigma[:2] = _HERE
    if config.start_heading is not None:
        mean[2] += math.remainder(config.start_heading - mean[2], 2.0 * math.pi)
        sigma[2] = config.start_heading_sigma
    return mean[None], sigma[None]


def _laid_on(local: LocalFixes, cut: CutPath, place: Complex) -> tuple[Array, Complex, bool]:
    """How far each pose (n,) turns to lie on the fixes, and where it is then.

    Besides, whether the fixes told the turn.
    """
    at_fix = place[np.searchsorted(cut.state_t, local.t)]
    laid = align(at_fix, local.place, local.sigma)
    shift = laid.place - np.exp(1j * laid.heading) * at_fix
    turn = np.interp(cut.state_t, local.t, laid.heading)
    east, north = (np.interp(cut.state_t, local.t, part) for part in (shift.real, shift.imag))
    return turn, np.exp(1j * turn) * place + east + 1j * north, laid.found


def _state_times(path_t: Array, marks: Array, knot: float) -> Array:
    """Times of the poses: marks and ends, and between them as many more as keep gaps below `knot`.

    path_t: (N,) s, of the odometry. In a silence of it, hours perhaps, there are the marks alone.
    """
    silences = np.flatnonzero(np.diff(path_t) > _SILENCE)
    t = np.union1d(marks, path_t[np.concatenate([[0, len(path_t) - 1], silences, silences + 1])])
    gaps = np.diff(t)
    within = np.isin(np.searchsorted(path_t, 0.5 * (t[:-1] + t[1:])) - 1, silences)
    pieces = np.maximum(np.ceil(np.where(within, 0.0, gaps) / knot - 1e-9), 1.0).astype(np.intp)
    first = np.repeat(t[:-1], pieces)
    number = np.arange(len(first)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return np.append(first + number * np.repeat(gaps / pieces, pieces), t[-1])
