"""The graph of a drive and its first guess: where the poses stand, and what is tied to them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.alignment import align_odometry
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.between import BetweenFactors, ComplexArray
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import SensorSamples
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.factors.prior import ConstantsPriorFactors, PosePriorFactors
from hubodo.fuse.graph.fixes import LocalFixes
from hubodo.fuse.graph.odometry_steps import SegmentedOdometry, segment_odometry
from hubodo.fuse.graph.result import DriveGraph
from hubodo.fuse.graph.solver import Solution
from hubodo.fuse.track import Track

_START_POSITION_SIGMA = 1e4
"""m; the frame stands at the median fix, and no drive is longer than that."""
_UNKNOWN_HEADING_SIGMA = math.pi / math.sqrt(3.0)
"""rad; 1 sigma of a heading of which nothing is known: even over a turn."""
_MAP_ORIGIN_SIGMA = 1e-3
"""m; without fixes the first pose is where the map begins."""
_MIN_ODOMETRY_OUTAGE = 2.0
"""s between poses of the odometry, from which on nothing was heard of the wheels. Estimated."""


def build_graph(
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
    marks = np.concatenate([path.t[:0], *(item.pose_times for item in measured)])
    marks = marks[(marks >= path.t[0]) & (marks <= path.t[-1])]
    cut = segment_odometry(path, _choose_pose_times(path.t, marks, config.max_pose_spacing), config.noise)
    factors = [factor for item in measured if (factor := item.build_factors(cut, config)) is not None]
    local = next((item for item in measured if isinstance(item, LocalFixes)), None)
    headings = next((factor for factor in factors if isinstance(factor, HeadingFactors)), None)
    poses, known = _guess_poses(cut, local, headings, config)
    if solution is not None:
        poses = solution.poses
    start = PosePriorFactors(np.zeros(1, np.intp), *_start_prior(poses[0], local is not None, config))
    graph = FactorGraph(
        (*factors, BetweenFactors.from_steps(cut.steps), start, build_constants_prior(config))
    )
    return DriveGraph(graph, poses, cut, known)


def build_constants_prior(config: GraphConfig) -> ConstantsPriorFactors:
    """What is known of the constants beforehand."""
    return ConstantsPriorFactors(
        np.zeros(1, np.intp), np.zeros((1, N_CONSTANTS)), config.constants.to_array()[None]
    )


def _guess_poses(
    cut: SegmentedOdometry, local: LocalFixes | None, headings: HeadingFactors | None, config: GraphConfig
) -> tuple[Array, bool]:
    """The odometry's poses (n, 3), turned to the headings and laid on the fixes.

    Besides, whether anything told the turn.
    """
    poses, known = cut.odometry_pose.copy(), config.start_heading is not None
    turn = 0.0 if config.start_heading is None else config.start_heading - poses[0, 2]
    if not known and headings is not None:
        off = np.exp(1j * (headings.heading - poses[headings.pose_index, 2]))
        turn, known = float(np.angle(off.sum())), True
    place = np.exp(1j * turn) * (poses[:, 0] + 1j * poses[:, 1])
    if local is not None:
        laid, place, by_fixes = _align_with_fixes(local, cut, place)
        known = known or by_fixes
        poses[:, 2] += laid
    poses[:, 2] += turn
    poses[:, 0], poses[:, 1] = place.real, place.imag
    return poses, known


def _start_prior(pose: Array, on_map: bool, config: GraphConfig) -> tuple[Array, Array]:
    """Mean and 1 sigma of the first pose, (1, 3) each."""
    mean, sigma = (
        pose.copy(),
        np.array([_START_POSITION_SIGMA, _START_POSITION_SIGMA, _UNKNOWN_HEADING_SIGMA]),
    )
    if not on_map:
        sigma[:2] = _MAP_ORIGIN_SIGMA
    if config.start_heading is not None:
        mean[2] += math.remainder(config.start_heading - mean[2], 2.0 * math.pi)
        sigma[2] = config.start_heading_sigma
    return mean[None], sigma[None]


def _align_with_fixes(
    local: LocalFixes, cut: SegmentedOdometry, place: ComplexArray
) -> tuple[Array, ComplexArray, bool]:
    """How far each pose (n,) turns to lie on the fixes, and where it is then.

    Besides, whether the fixes told the turn.
    """
    at_fix = place[np.searchsorted(cut.pose_t, local.t)]
    laid = align_odometry(at_fix, local.position, local.sigma)
    shift = laid.position - np.exp(1j * laid.turn) * at_fix
    turn = np.interp(cut.pose_t, local.t, laid.turn)
    east, north = (np.interp(cut.pose_t, local.t, part) for part in (shift.real, shift.imag))
    return turn, np.exp(1j * turn) * place + east + 1j * north, laid.turn_observable


def _choose_pose_times(path_t: Array, marks: Array, knot: float) -> Array:
    """Times of the poses: marks and ends, and between them as many more as keep gaps below `knot`.

    path_t: (N,) s, of the odometry. In a silence of it, hours perhaps, there are the marks alone.
    """
    silences = np.flatnonzero(np.diff(path_t) > _MIN_ODOMETRY_OUTAGE)
    t = np.union1d(marks, path_t[np.concatenate([[0, len(path_t) - 1], silences, silences + 1])])
    gaps = np.diff(t)
    within = np.isin(np.searchsorted(path_t, 0.5 * (t[:-1] + t[1:])) - 1, silences)
    pieces = np.maximum(np.ceil(np.where(within, 0.0, gaps) / knot - 1e-9), 1.0).astype(np.intp)
    first = np.repeat(t[:-1], pieces)
    number = np.arange(len(first)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return np.append(first + number * np.repeat(gaps / pieces, pieces), t[-1])
