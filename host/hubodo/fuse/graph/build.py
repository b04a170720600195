"""Construction of a drive's graph: pose times, factors, and the initial guess of the poses."""

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
"""m, 1 sigma of the first pose; the frame's origin is the median fix, and no drive is longer."""
_UNKNOWN_HEADING_SIGMA = math.pi / math.sqrt(3.0)
"""rad, 1 sigma of a uniform distribution over a turn."""
_MAP_ORIGIN_SIGMA = 1e-3
"""m; without fixes the first pose defines the origin of the map."""
_MIN_ODOMETRY_OUTAGE = 2.0
"""s between odometry poses from which on the wheels count as not received. Estimated."""


def build_graph(
    path: Track,
    samples: Sequence[SensorSamples],
    config: GraphConfig,
    solution: Solution | None = None,
    heading_observable: bool | None = None,
) -> DriveGraph:
    """Build the graph of a drive from its odometry and the samples measured along it.

    It has a pose at each time that the samples ask for, at both ends of the odometry and of its outages, and
    further poses at most `max_pose_spacing` apart except in outages. solution: solution of a graph with the
    same poses, used in place of an initial guess. heading_observable: that of a graph with the same samples,
    where known; no initial guess is then needed.
    """
    times = np.concatenate([path.t[:0], *(sensor.pose_times for sensor in samples)])
    times = times[(times >= path.t[0]) & (times <= path.t[-1])]
    odometry = segment_odometry(
        path, _choose_pose_times(path.t, times, config.max_pose_spacing), config.noise
    )
    factors = [factor for sensor in samples if (factor := sensor.build_factors(odometry, config)) is not None]
    fixes = next((sensor for sensor in samples if isinstance(sensor, LocalFixes)), None)
    headings = next((factor for factor in factors if isinstance(factor, HeadingFactors)), None)
    if solution is not None and heading_observable is not None:
        poses = solution.poses
    else:
        poses, heading_observable = _guess_poses(odometry, fixes, headings, config)
        poses = poses if solution is None else solution.poses
    start = PosePriorFactors(np.zeros(1, np.intp), *_start_prior(poses[0], fixes is not None, config))
    graph = FactorGraph(
        (*factors, BetweenFactors.from_steps(odometry.steps), start, build_constants_prior(config))
    )
    return DriveGraph(graph, poses, odometry, heading_observable)


def build_constants_prior(config: GraphConfig) -> ConstantsPriorFactors:
    """Return the prior of the odometry's constant errors."""
    return ConstantsPriorFactors(
        np.zeros(1, np.intp), np.zeros((1, N_CONSTANTS)), config.constants.to_array()[None]
    )


def _guess_poses(
    odometry: SegmentedOdometry,
    fixes: LocalFixes | None,
    headings: HeadingFactors | None,
    config: GraphConfig,
) -> tuple[Array, bool]:
    """Return the odometry's poses (n, 3), rotated to the headings and aligned with the fixes.

    The second value tells whether anything determined the rotation.
    """
    poses, observable = odometry.odometry_pose.copy(), config.start_heading is not None
    turn = 0.0 if config.start_heading is None else config.start_heading - poses[0, 2]
    if not observable and headings is not None:
        errors = np.exp(1j * (headings.heading - poses[headings.pose_index, 2]))
        turn, observable = float(np.angle(errors.sum())), True
    position = np.exp(1j * turn) * (poses[:, 0] + 1j * poses[:, 1])
    if fixes is not None:
        turn_at_pose, position, by_fixes_too = _align_with_fixes(fixes, odometry, position)
        observable = observable or by_fixes_too
        poses[:, 2] += turn_at_pose
    poses[:, 2] += turn
    poses[:, 0], poses[:, 1] = position.real, position.imag
    return poses, observable


def _start_prior(pose: Array, on_map: bool, config: GraphConfig) -> tuple[Array, Array]:
    """Return mean and 1 sigma of the first pose, (1, 3) each."""
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
    fixes: LocalFixes, odometry: SegmentedOdometry, position: ComplexArray
) -> tuple[Array, ComplexArray, bool]:
    """Return the rotation of each pose (n,) onto the fixes, and the rotated positions.

    The third value tells whether the fixes determined the rotation.
    """
    odometry_at_fix = position[np.searchsorted(odometry.pose_t, fixes.t)]
    alignment = align_odometry(odometry_at_fix, fixes.position, fixes.sigma)
    shift = alignment.position - np.exp(1j * alignment.turn) * odometry_at_fix
    turn = np.interp(odometry.pose_t, fixes.t, alignment.turn)
    east, north = (np.interp(odometry.pose_t, fixes.t, part) for part in (shift.real, shift.imag))
    return turn, np.exp(1j * turn) * position + east + 1j * north, alignment.turn_observable


def _choose_pose_times(path_t: Array, times: Array, spacing: float) -> Array:
    """Return the times of the poses: `times`, the ends of odometry and outages, and times between them.

    path_t: (N,) s of the odometry. Gaps are filled up to `spacing`, s; an outage, hours perhaps, is not.
    """
    outages = np.flatnonzero(np.diff(path_t) > _MIN_ODOMETRY_OUTAGE)
    t = np.union1d(times, path_t[np.concatenate([[0, len(path_t) - 1], outages, outages + 1])])
    gaps = np.diff(t)
    in_outage = np.isin(np.searchsorted(path_t, 0.5 * (t[:-1] + t[1:])) - 1, outages)
    n_parts = np.maximum(np.ceil(np.where(in_outage, 0.0, gaps) / spacing - 1e-9), 1.0).astype(np.intp)
    part_start = np.repeat(t[:-1], n_parts)
    part = np.arange(len(part_start)) - np.repeat(np.cumsum(n_parts) - n_parts, n_parts)
    return np.append(part_start + part * np.repeat(gaps / n_parts, n_parts), t[-1])
