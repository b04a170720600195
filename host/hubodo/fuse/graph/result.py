"""Result of the factor graph: poses at the odometry's times, sigmas and constants."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import (
    CONSTANT_NAMES,
    CURVATURE,
    GNSS_DELAY,
    WHEEL_RADIUS,
    YAW_RATE,
    YAW_SCALE,
)
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.odometry_steps import SegmentedOdometry, StepNoise
from hubodo.fuse.graph.solver import Solution
from hubodo.fuse.projection import LocalFrame
from hubodo.fuse.track import Track, cross_covariances


@dataclass(frozen=True, eq=False)
class GraphResult:
    """Solution of a whole drive.

    Attributes
    ----------
    track : poses at the odometry's times, m east and north of `frame` (of the odometry's start without GNSS).
    from_start : the same, shifted to start at 0, 0, with sigmas of the displacement since.
    constants : estimates by the names of ConstantSigmas; gnss_delay is the total delay of the fixes.
    frame : map frame; None if there is no GNSS.
    fix_t : (M,) s of the usable fixes.
    fix_weight : (M,) weight of each fix, 0 to 1.
    sigma_growth : factor by which the sigmas of the fixes were inflated.
    noise : noise of the odometry, as estimated for this drive.
    warnings : one line each.
    pose_t : (n,) s of the graph's poses.
    graph, solution : the graph and its optimum.
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
    """A graph with its initial guess.

    Attributes
    ----------
    graph : the factors.
    initial_poses : (n, 3).
    odometry : cut at the poses.
    heading_observable : whether any measurement determines the heading.
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
    sigma_growth: float,
    noise: StepNoise,
    shift: float,
    warnings: tuple[str, ...],
) -> GraphResult:
    """Return the result of a drive from a solution with all covariances.

    sigma_growth: factor by which the sigmas of the fixes were inflated. noise: noise of the odometry. shift:
    s added to the times of the fixes.
    """
    odometry, graph = drive.odometry, drive.graph
    constant_sigma = np.sqrt(np.diag(solution.constants_covariance))
    constants = {
        name: Quantity(float(value) + (shift if index == GNSS_DELAY else 0.0), float(sigma))
        for index, (name, value, sigma) in enumerate(
            zip(CONSTANT_NAMES, solution.constants, constant_sigma, strict=True)
        )
    }
    covariance, with_start = solution.covariance, solution.start_covariance
    since_start = covariance.copy()
    # Only the position counts from the start; the heading is that of the map.
    since_start[:, :2, :2] += covariance[0, :2, :2] - with_start[:, :2, :2]
    since_start[:, :2, :2] -= with_start[:, :2, :2].transpose(0, 2, 1)
    since_start[:, :2, 2] -= with_start[:, 2, :2]
    since_start[:, 2, :2] = since_start[:, :2, 2]
    track = _interpolate_track(path, odometry, graph, solution, covariance)
    from_start = _interpolate_track(path, odometry, graph, solution, since_start)
    from_start = replace(from_start, x=from_start.x - track.x[0], y=from_start.y - track.y[0])
    fix_t, weight = path.t[:0], np.zeros(0)
    positions = graph.find_group(PositionFactors)
    if positions is not None:
        item = positions.linearise(solution.poses, solution.constants)
        fix_t, weight = odometry.pose_t[item.pose_index], positions.loss.weight(item.squared_norms)
    return GraphResult(
        track,
        from_start,
        constants,
        frame,
        fix_t - shift,
        weight,
        sigma_growth,
        noise,
        warnings,
        odometry.pose_t,
        graph,
        solution,
    )


def _odometry_speed(path: Track) -> Array:
    """Return the speed of the odometry, (N,) m/s, computed from its steps if it has none.

    Differences of fused positions would contain their corrections, also at standstill.
    """
    if len(path.speed):
        return path.speed
    step = np.diff(path.x) + 1j * np.diff(path.y)
    mean_heading = np.unwrap(path.heading)
    forward = (step * np.exp(-0.5j * (mean_heading[1:] + mean_heading[:-1]))).real / np.diff(path.t)
    return np.append(forward[0], forward)


def _interpolate_track(
    path: Track, odometry: SegmentedOdometry, graph: FactorGraph, solution: Solution, covariance: Array
) -> Track:
    """Return poses at the odometry's times, from its steps corrected by the estimated constants.

    The remaining misfit at the end of each segment is spread evenly over its time.
    """
    steps, constants, poses = odometry.steps, solution.constants, solution.poses
    displacements = steps.correct_displacements(constants)
    cumulative = np.cumsum(displacements)
    since_segment_start = cumulative - (cumulative - displacements)[steps.first_step][odometry.segment]
    turn_since_start = odometry.since_segment_start @ (
        np.array([1.0, 0.0, 0.0]) + constants[[YAW_SCALE, YAW_RATE, CURVATURE]]
    )
    start_pose, end_pose = poses[:-1][odometry.segment], poses[1:][odometry.segment]
    direction = np.exp(1j * start_pose[:, 2])
    segment_displacement = np.add.reduceat(displacements, steps.first_step)[odometry.segment]
    position_misfit = (
        (end_pose[:, 0] - start_pose[:, 0])
        + 1j * (end_pose[:, 1] - start_pose[:, 1])
        - direction * segment_displacement
    )
    heading_misfit = end_pose[:, 2] - start_pose[:, 2] - steps.correct_turns(constants)[odometry.segment]
    position = (
        start_pose[:, 0]
        + 1j * start_pose[:, 1]
        + direction * since_segment_start
        + odometry.elapsed_fraction * position_misfit
    )
    heading = start_pose[:, 2] + turn_since_start + odometry.elapsed_fraction * heading_misfit
    step_index = np.searchsorted(odometry.step_end_t, path.t[1:])
    x, y = (
        np.append(poses[0, 0], position.real[step_index]),
        np.append(poses[0, 1], position.imag[step_index]),
    )
    heading_at_pose = np.append(poses[0, 2], heading[step_index])
    speed = (1.0 + constants[WHEEL_RADIUS]) * _odometry_speed(path)
    variance = np.maximum(np.einsum("kii->ik", covariance), 0.0)
    sigma = [np.sqrt(np.interp(path.t, odometry.pose_t, column)) for column in variance]
    crossed = [np.interp(path.t, odometry.pose_t, column) for column in cross_covariances(covariance)]
    names = ("cov_xy", "cov_x_heading", "cov_y_heading")
    track = Track(path.t, x, y, heading_at_pose, speed, *sigma)
    return replace(track, **dict(zip(names, crossed, strict=True)))
