"""The result of the factor graph: poses at the odometry's times, sigmas, constants."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import CONSTANT_NAMES, CURVATURE, GNSS_DELAY, YAW_RATE, YAW_SCALE
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.odometry_steps import SegmentedOdometry, StepNoise
from hubodo.fuse.graph.solver import Solution
from hubodo.fuse.projection import LocalFrame
from hubodo.fuse.track import Track


@dataclass(frozen=True, eq=False)
class GraphResult:
    """What the graph found.

    track: poses at the odometry's times, in metres east and north of `frame` (of the odometry's own start
    without GNSS). from_start: the same, shifted to begin at 0, 0, with sigmas of the way since. constants:
    by the names of ConstantSigmas; gnss_delay is that of the fixes in all. fix_t: (M,) s of the usable fixes,
    fix_weight: (M,) 0 to 1, what each counted, sigma_growth: times which their sigma was widened.
    noise: of the odometry, as this drive shows it.
    warnings: one line each. pose_t: (n,) s of the graph's poses; graph, solution: for who wants more.
    """

    track: Track
    from_start: Track
    constants: dict[str, Quantity]
    frame: LocalFrame | None
    fix_t: Array
    fix_weight: Array
    sigma_growth: float
    noise: StepNoise
    warnings: tuple[str, ...]
    pose_t: Array
    graph: FactorGraph
    solution: Solution


@dataclass(frozen=True, eq=False)
class DriveGraph:
    """A graph with its first guess, and how it came about.

    heading_known: whether anything tells the heading.
    """

    graph: FactorGraph
    initial_poses: Array
    odometry: SegmentedOdometry
    heading_observable: bool


def build_result(
    path: Track,
    drive: DriveGraph,
    solution: Solution,
    frame: LocalFrame | None,
    grown: float,
    noise: StepNoise,
    shift: float,
    warnings: tuple[str, ...],
) -> GraphResult:
    """What a solution with all covariances says of the whole drive.

    grown: times which the fixes' sigma was widened. noise: of the odometry. shift: s that was
    added to the fixes' times.
    """
    cut, graph = drive.odometry, drive.graph
    sigma_of = np.sqrt(np.diag(solution.constants_covariance))
    constants = {
        name: Quantity(float(value) + (shift if index == GNSS_DELAY else 0.0), float(sigma))
        for index, (name, value, sigma) in enumerate(
            zip(CONSTANT_NAMES, solution.constants, sigma_of, strict=True)
        )
    }
    variance = np.einsum("kii->ki", solution.covariance)
    variance = np.maximum(variance, 0.0)
    cross = np.einsum("kii->ki", solution.start_covariance)
    since = np.maximum(variance + variance[0] - 2.0 * cross, 0.0)
    since[:, 2] = variance[:, 2]
    track = _interpolate_track(path, cut, graph, solution, variance)
    from_start = _interpolate_track(path, cut, graph, solution, since)
    from_start = replace(from_start, x=from_start.x - track.x[0], y=from_start.y - track.y[0])
    fix_t, weight = path.t[:0], np.zeros(0)
    positions = graph.find(PositionFactors)
    if positions is not None:
        item = positions.linearise(solution.poses, solution.constants)
        fix_t, weight = cut.pose_t[item.pose_index], positions.loss.weight(item.squared_norms)
    return GraphResult(
        track,
        from_start,
        constants,
        frame,
        fix_t - shift,
        weight,
        grown,
        noise,
        warnings,
        cut.pose_t,
        graph,
        solution,
    )


def _interpolate_track(
    path: Track, cut: SegmentedOdometry, graph: FactorGraph, solution: Solution, variance: Array
) -> Track:
    """Poses at the odometry's times: the steps with the constants found.

    What a stretch still lacks at its end is spread evenly over its time.
    """
    steps, constants, poses = cut.steps, solution.constants, solution.poses
    moves = steps.correct_displacements(constants)
    total = np.cumsum(moves)
    since = total - (total - moves)[steps.first_step][cut.segment]
    turned = cut.since_segment_start @ (
        np.array([1.0, 0.0, 0.0]) + constants[[YAW_SCALE, YAW_RATE, CURVATURE]]
    )
    begin, end = poses[:-1][cut.segment], poses[1:][cut.segment]
    forward = np.exp(1j * begin[:, 2])
    moved = np.add.reduceat(moves, steps.first_step)[cut.segment]
    missing = (end[:, 0] - begin[:, 0]) + 1j * (end[:, 1] - begin[:, 1]) - forward * moved
    lacking = end[:, 2] - begin[:, 2] - steps.correct_turns(constants)[cut.segment]
    place = begin[:, 0] + 1j * begin[:, 1] + forward * since + cut.elapsed_fraction * missing
    heading = begin[:, 2] + turned + cut.elapsed_fraction * lacking
    use = np.searchsorted(cut.step_end_t, path.t[1:])
    x, y = np.append(poses[0, 0], place.real[use]), np.append(poses[0, 1], place.imag[use])
    along = np.append(poses[0, 2], heading[use])
    speed = np.hypot(np.diff(x), np.diff(y)) / np.diff(path.t)
    speed *= np.where(np.diff(x) * np.cos(along[1:]) + np.diff(y) * np.sin(along[1:]) < 0.0, -1.0, 1.0)
    speed = np.append(speed[0], speed)
    sigma = [np.sqrt(np.interp(path.t, cut.pose_t, column)) for column in variance.T]
    return Track(path.t, x, y, along, speed, *sigma)
