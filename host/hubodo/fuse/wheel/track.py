"""Track of a recording: runs of the wheel filter, one wheel alone where the two do not form an axle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.track import Track, cross_covariances
from hubodo.fuse.wheel import smoother
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.drive_report import WheelReport, build_report, rolled_mostly_backwards
from hubodo.fuse.wheel.filter import ALIGNMENT_WINDOWS, WheelFilter
from hubodo.fuse.wheel.fixed_lag import smooth_with_lag
from hubodo.fuse.wheel.node_screening import correct_mirrored_axes, find_own_gaps
from hubodo.fuse.wheel.preintegration import sample_block
from hubodo.fuse.wheel.records import Pose, StepInput, common_scale_covariance
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeeds
from hubodo.fuse.wheel.window import WINDOW_S, WINDOWS_PER_SECOND
from hubodo.recording import Table
from hubodo.vehicle import side_sign

_CLOCK_JUMP_WINDOWS = WINDOWS_PER_SECOND
"""Windows in which the wheels disagree after which a clock is doubted."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WheelTrack(Track):
    """A track of the wheel filter, with its covariance and statistics; the heading is unwrapped.

    Attributes
    ----------
    covariance : (N, 5, 5) of x, y, heading, speed, yaw_rate.
    motion_state : values of `MotionState`.
    nis, dof : normalised innovation squared of each step and its degrees of freedom.
    inertial_speed : 1 where only accelerometers measured the speed.
    """

    covariance: Array
    motion_state: Array
    nis: Array
    dof: Array
    inertial_speed: Array

    def with_covariance(self, covariance: Array) -> WheelTrack:
        """Return the track with another covariance, and with its sigmas and step inflations updated."""
        sigma_x, sigma_y, sigma_heading = np.sqrt(np.maximum(np.einsum("nii->in", covariance), 0.0))[:3]
        cov_xy, cov_x_heading, cov_y_heading = cross_covariances(covariance)
        return replace(
            self,
            covariance=covariance,
            cov_xy=cov_xy,
            cov_x_heading=cov_x_heading,
            cov_y_heading=cov_y_heading,
            sigma_x=sigma_x,
            sigma_y=sigma_y,
            sigma_heading=sigma_heading,
            step_inflation=_step_inflation(self, covariance),
        )


def _step_inflation(track: WheelTrack, covariance: Array) -> Array:
    """Return the variance of each step beyond that of rolling wheels, (N - 1,) m² in any direction.

    While only accelerometers measure the speed, it is the growth of the position variance. A step whose
    length disagrees with its speed corrects earlier steps, so its whole length counts as error.
    """
    dt = np.diff(track.t)
    course = 0.5 * (track.heading[:-1] + track.heading[1:])
    displacement = np.diff(track.x) + 1j * np.diff(track.y)
    correction = np.abs(displacement - track.speed[1:] * dt * np.exp(1j * course)) ** 2
    variance_growth = np.maximum(0.0, np.diff(covariance[:, 0, 0] + covariance[:, 1, 1]))
    # The speed at the end of an outage does not predict the distance during it.
    return np.where(dt < 1.5 * WINDOW_S, correction, 0.0) + np.where(
        track.inertial_speed[1:] > 0.0, variance_growth, 0.0
    )


@dataclass(frozen=True, eq=False)
class WheelRun:
    """Result of a filter run over a recording."""

    track: WheelTrack
    report: WheelReport
    filter: WheelFilter = field(repr=False)

    def with_warning(self, line: str) -> WheelRun:
        """Return the same result with one more warning in front."""
        return replace(self, report=replace(self.report, warnings=(line, *self.report.warnings)))


def run_wheel_filter(
    config: WheelConfig, nodes: Mapping[str, Table], lag: float = 0.0, speeds: SurfaceSpeeds | None = None
) -> WheelRun:
    """Run the wheel filter over the nodes in `config` that `nodes` holds (t, gx, gy, gz, ax, ay, az).

    lag: s of later samples used for each pose; inf smooths over the whole log. The cost grows with a finite
    lag; one as long as the log equals inf up to rounding. speeds: surface speeds of another odometer, if the
    config is encoder-aided. Raise ValueError if there is no complete window: less than a fifth of a second
    of samples.
    """
    nodes, mirror_warnings = correct_mirrored_axes(config, nodes)
    if mirror_warnings:
        run = run_wheel_filter(config, nodes, lag, speeds)
        return replace(run, report=replace(run.report, warnings=(*mirror_warnings, *run.report.warnings)))
    wheel_filter = WheelFilter(config, speeds)
    if lag > 0.0:
        wheel_filter.recorded_steps = []
    if math.isinf(lag):
        wheel_filter.record_for_smoothing()
    blocks = {name: sample_block(nodes[name]) for name in config.nodes if name in nodes}
    poses = [*wheel_filter.handle_blocks(blocks).poses, *wheel_filter.finish().poses]
    if not poses:
        raise ValueError("the nodes have less than a fifth of a second of samples: nothing to filter")

    def rerun(nodes: Mapping[str, Table], config: WheelConfig = config) -> WheelRun:
        return run_wheel_filter(config, nodes, lag, speeds)

    corrected_run = _rerun_without_clock_jump(nodes, wheel_filter, rerun) or _rerun_single_wheel(
        nodes, wheel_filter, rerun
    )
    if corrected_run is not None:
        return corrected_run
    steps = wheel_filter.recorded_steps or []
    first_pass = wheel_filter.core.slip_schedule, wheel_filter.core.outage_ends
    if lag >= len(steps) * WINDOW_S > 0.0:
        poses = _smooth(wheel_filter, poses, steps)
    elif lag > 0.0:
        ahead = math.ceil(lag / WINDOW_S - 1e-9)
        poses = smooth_with_lag(config, steps, ALIGNMENT_WINDOWS, ahead, *first_pass)
    track = track_from_poses(poses)
    if lag > 0.0:
        # The filter has added it to its own poses only.
        scale = common_scale_covariance(wheel_filter.core.common_scale_sigma, track.x, track.y, track.speed)
        track = track.with_covariance(track.covariance + scale)
    if len(wheel_filter.core.wheels) == 1 and rolled_mostly_backwards(wheel_filter.core.wheels[0]):
        track = track.with_covariance(_mirrored_covariance(track))
    report = build_report(wheel_filter, track, track.motion_state, lag)
    return WheelRun(track, report, wheel_filter)


def _smooth(wheel_filter: WheelFilter, poses: list[Pose], steps: Sequence[StepInput]) -> list[Pose]:
    """Return the poses of a first pass, each from the whole log."""
    core, terms = wheel_filter.core, wheel_filter.smoothing_terms
    if terms is None:
        poses, terms = smoother.run_second_pass(core, steps, ALIGNMENT_WINDOWS)
    return smoother.smooth_whole_log(poses, terms, core.pose_columns)


def _rerun_without_clock_jump(
    nodes: Mapping[str, Table], wheel_filter: WheelFilter, rerun: Callable[..., WheelRun]
) -> WheelRun | None:
    """Return a run that ends at a gap in one node alone, if the wheels disagree after the gap.

    In that case the node's clock jumped by an unknown amount. Returns None if the wheels still agree, as
    after lost samples.
    """
    outlier_windows = sum(wheel.counts.outlier_windows for wheel in wheel_filter.core.wheels)
    gaps = find_own_gaps([nodes[name] for name in wheel_filter.config.nodes if name in nodes])
    is_contradicted = wheel_filter.core.mounting_check.usable_side != 0.0
    if (
        (outlier_windows < _CLOCK_JUMP_WINDOWS and not is_contradicted)
        or len(gaps) != 2
        or all(gaps)
        or not any(gaps)
    ):
        return None
    name, t = next((name, gap[0]) for name, gap in zip(wheel_filter.config.nodes, gaps, strict=True) if gap)
    table = nodes[name]
    before = Table({key: column[table.t <= t] for key, column in table.columns.items()})
    result = rerun({**nodes, name: before})
    outliers_before = sum(wheel.counts.outlier_windows for wheel in result.filter.core.wheels)
    is_resolved = is_contradicted and result.filter.core.mounting_check.usable_side == 0.0
    if outlier_windows - outliers_before < _CLOCK_JUMP_WINDOWS + outliers_before and not is_resolved:
        return None
    return result.with_warning(
        f"{name}: its clock jumped at t = {t:.1f} s; what came then is left out, sigmas grow there"
    )


def _rerun_single_wheel(
    nodes: Mapping[str, Table], wheel_filter: WheelFilter, rerun: Callable[..., WheelRun]
) -> WheelRun | None:
    """Return the run of one wheel if the two are not an axle; None if they are."""
    check, wheels = wheel_filter.core.mounting_check, wheel_filter.core.wheels
    if not check.usable_side:
        return None
    runs = {
        wheel.name: rerun(
            nodes, replace(wheel_filter.config, nodes={wheel.name: _on_side(wheel.node, check.sides_swapped)})
        )
        for wheel in wheels
        if check.other_wheel_steers or side_sign(wheel.node.side) == check.usable_side
    }
    # Each node measures the yaw rate of its own wheel, which for a steered wheel includes the steering rate.
    name = min(runs, key=lambda one: float(np.sum(runs[one].track.yaw_rate ** 2)))
    comparison = "".join(f"; {one} turns more than {name}" for one in runs if one != name)
    return runs[name].with_warning(f"{check.verdict}{comparison}; the track comes from {name} alone")


def _on_side(node: WheelNode, sides_swapped: bool) -> WheelNode:
    """Return the node, on the other side if the two are exchanged."""
    if not sides_swapped:
        return node
    return replace(node, side="right" if node.side == "left" else "left")


def _mirrored_covariance(track: WheelTrack) -> Array:
    """Return the covariance (N, 5, 5) of a track whose direction of travel is ambiguous.

    With the other facing, the vehicle would drive forwards with the same headings: every position would be
    the start minus its displacement.
    """
    mirror_offset = np.zeros((len(track.t), 5))
    mirror_offset[:, 0], mirror_offset[:, 1], mirror_offset[:, 3] = (
        2.0 * track.x,
        2.0 * track.y,
        2.0 * track.speed,
    )
    return np.asarray(track.covariance + mirror_offset[:, :, None] * mirror_offset[:, None, :])


def track_from_poses(poses: Sequence[Pose]) -> WheelTrack:
    """Return the poses as arrays."""
    pose_columns = np.array([pose[:6] for pose in poses], np.float64)
    t, x, y, heading, speed, yaw_rate = (np.ascontiguousarray(column) for column in pose_columns.T)
    covariance = np.array([pose.covariance for pose in poses])
    motion_states = np.array([pose.motion_state for pose in poses], np.float64)
    nis = np.array([pose.nis for pose in poses])
    dofs = np.array([pose.dof for pose in poses], np.float64)
    inertial = np.array([pose.inertial_speed for pose in poses], np.float64)
    track = WheelTrack(
        *(t, x, y, heading, speed),
        yaw_rate=yaw_rate,
        covariance=covariance,
        motion_state=motion_states,
        nis=nis,
        dof=dofs,
        inertial_speed=inertial,
    )
    return track.with_covariance(covariance)
