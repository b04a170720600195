"""Wheel odometry of a recording: track, learnt parameters and warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.track import Track
from hubodo.fuse.wheel import smoother
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.drive_warnings import list_warnings, rolled_mostly_backwards
from hubodo.fuse.wheel.entries import OBSERVABLE_WITH_TWO_WHEELS, VEHICLE_ENTRIES, WHEEL_ENTRIES, Entry
from hubodo.fuse.wheel.filter import ALIGNMENT_WINDOWS, WheelFilter
from hubodo.fuse.wheel.fixed_lag import smooth_with_lag
from hubodo.fuse.wheel.node_screening import find_own_gaps
from hubodo.fuse.wheel.outage_log import WheelOutage
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.slip_detector import Slip
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeeds
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.fuse.wheel.window import SECOND_WINDOWS, WINDOW_S
from hubodo.recording import Table
from hubodo.vehicle import side_sign

_CLOCK_JUMP_WINDOWS = SECOND_WINDOWS
"""Windows in which the wheels disagree after which a clock is doubted."""


@dataclass(frozen=True, eq=False)
class WheelTrack:
    """Poses of the body origin, arrays of length N.

    Attributes
    ----------
    t : s on the log's clock.
    x, y : m from the start.
    heading : rad, unwrapped.
    speed, yaw_rate : m/s and rad/s, means over the window that ends at t.
    covariance : (N, 5, 5) of x, y, heading, speed, yaw_rate.
    motion_state : values of `MotionState`.
    nis, dof : normalised innovation squared of each step and its degrees of freedom.
    inertial_speed : 1 where only accelerometers measured the speed.
    """

    t: Array
    x: Array
    y: Array
    heading: Array
    speed: Array
    yaw_rate: Array
    covariance: Array
    motion_state: Array
    nis: Array
    dof: Array
    inertial_speed: Array

    def to_track(self) -> Track:
        """Return the common track type, with sigmas instead of covariances."""
        sigma = np.sqrt(np.maximum(np.einsum("nii->in", self.covariance), 0.0))
        x, y, heading = sigma[:3]
        return Track(self.t, self.x, self.y, self.heading, self.speed, x, y, heading, self.yaw_rate)


@dataclass(frozen=True)
class WheelReport:
    """Parameters learnt from a drive, and what happened in it.

    Attributes
    ----------
    distance : m along the track.
    duration, end : s; end is the time of the last pose.
    method : sentence.
    vehicle, nodes : effect -> parameter -> value and sigma as in a calibration file, nodes by name and in
    their own axes. Entries that one wheel cannot observe are left out; a mean of two parameters is listed
    for both.
    counts : by node, windows slipping, clipped and missing, samples refused.
    slips : by node, the periods in which its wheel slipped.
    warnings : one line each, except for slips.
    outages : periods without any wheel, s, and whether the vehicle was stationary.
    """

    distance: float
    duration: float
    end: float
    method: str
    vehicle: Mapping[str, Mapping[str, Quantity]]
    nodes: Mapping[str, Mapping[str, Mapping[str, Quantity]]]
    counts: Mapping[str, Mapping[str, int]]
    slips: Mapping[str, tuple[Slip, ...]]
    warnings: tuple[str, ...]
    outages: tuple[WheelOutage, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the entries of fuse.json."""
        return {
            "distance": self.distance,
            "duration": self.duration,
            "method": self.method,
            "vehicle": _quantities_json(self.vehicle),
            "nodes": {name: _quantities_json(effects) for name, effects in self.nodes.items()},
            "counts": {name: dict(value) for name, value in self.counts.items()},
            "silences": [
                {"begin": outage.start, "end": outage.end, "stood": outage.was_stationary}
                for outage in self.outages
            ],
            "slips": [
                {"node": name, "from": slip.start, "to": min(slip.end, self.end), "speed": slip.speed}
                for name, outlier_windows in self.slips.items()
                for slip in outlier_windows
            ],
            "warnings": [
                *(
                    f"{name}: {slip.description}"
                    for name, outlier_windows in self.slips.items()
                    for slip in outlier_windows
                ),
                *self.warnings,
            ],
        }


def _quantities_json(effects: Mapping[str, Mapping[str, Quantity]]) -> dict[str, dict[str, dict[str, float]]]:
    return {name: {key: asdict(item) for key, item in result.items()} for name, result in effects.items()}


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
    wheel_filter = WheelFilter(config, speeds)
    if lag > 0.0:
        wheel_filter.recorded_steps = []
    blocks = {
        name: (nodes[name].t, nodes[name].gyro, nodes[name].accel) for name in config.nodes if name in nodes
    }
    poses = [*wheel_filter.handle_many(blocks).poses, *wheel_filter.finish().poses]
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
    if lag >= len(steps) * WINDOW_S > 0.0:
        poses = smoother.smooth_whole_log(config, steps, ALIGNMENT_WINDOWS, wheel_filter.core.slip_schedule)
    elif lag > 0.0:
        ahead = math.ceil(lag / WINDOW_S - 1e-9)
        poses = smooth_with_lag(config, steps, ALIGNMENT_WINDOWS, ahead, wheel_filter.core.slip_schedule)
    track = track_from_poses(poses)
    if len(wheel_filter.core.wheels) == 1 and rolled_mostly_backwards(wheel_filter.core.wheels[0]):
        track = replace(track, covariance=_mirrored_covariance(track))
    return WheelRun(track, build_report(wheel_filter, track, lag), wheel_filter)


def _rerun_without_clock_jump(
    nodes: Mapping[str, Table], wheel_filter: WheelFilter, rerun: Callable[..., WheelRun]
) -> WheelRun | None:
    """Return a run without what follows a gap in one node alone, if the wheels disagree since then.

    In that case its clock jumped by an unknown amount. Return None if all is well: after lost samples the
    wheels still agree.
    """
    outlier_windows = sum(wheel.outlier_windows for wheel in wheel_filter.core.wheels)
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
    outliers_before = sum(wheel.outlier_windows for wheel in result.filter.core.wheels)
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
    # Each measures its own yaw rate; a steered wheel adds its steering to the vehicle's turning.
    name = min(runs, key=lambda one: float(np.sum(runs[one].track.yaw_rate ** 2)))
    comparison = "".join(f"; {one} turns more than {name}" for one in runs if one != name)
    return runs[name].with_warning(f"{check.verdict}{comparison}; the track comes from {name} alone")


def _on_side(node: WheelNode, sides_swapped: bool) -> WheelNode:
    """Return the node, on the other side if the two are exchanged."""
    if not sides_swapped:
        return node
    return replace(node, side="right" if node.side == "left" else "left")


def _mirrored_covariance(track: WheelTrack) -> Array:
    """Return the covariance (N, 5, 5) of a track that may as well be its own mirror image.

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
    return WheelTrack(t, x, y, heading, speed, yaw_rate, covariance, motion_states, nis, dofs, inertial)


def build_report(wheel_filter: WheelFilter, track: WheelTrack, lag: float = 0.0) -> WheelReport:
    """Return what a filter knows after its last pose; lag: as for `run_wheel_filter`."""
    wheels = wheel_filter.core.wheels
    names = " and ".join(wheel.name for wheel in wheels)
    causality = "filtered, each pose from the past alone"
    if lag > 0.0:
        ahead = f"what came up to {lag:g} s after it" if math.isfinite(lag) else "the whole log"
        causality = f"smoothed, each pose from {ahead}: not causal"
    observable = [
        entry for entry in VEHICLE_ENTRIES if len(wheels) == 2 or entry not in OBSERVABLE_WITH_TWO_WHEELS
    ]
    vehicle = _quantities(wheel_filter, None, observable)
    nodes = {wheel.name: _quantities(wheel_filter, wheel, WHEEL_ENTRIES) for wheel in wheels}
    counts = {
        wheel.name: {
            "windows_slipping": wheel.outlier_windows + wheel_filter.core.slip_schedule.count_windows(index),
            "windows_clipped": wheel.clipped_windows,
            "windows_unheard": wheel.missing_windows,
            "samples_refused": wheel_filter.refused[wheel.name],
        }
        for index, wheel in enumerate(wheels)
    }
    outlier_windows = {
        wheel.name: tuple(wheel.slip_detector.slips) for wheel in wheels if wheel.slip_detector.slips
    }
    duration, end = float(track.t[-1] - track.t[0]) + WINDOW_S, float(track.t[-1])
    warning_lines = tuple(list_warnings(wheel_filter, track.motion_state))
    outages = tuple(wheel_filter.core.outages.listed)
    encoder_note = " with the surface speeds of another odometer" if wheel_filter.config.encoder_aided else ""
    method = f"wheel filter on {names}{encoder_note}, {causality}"
    return WheelReport(
        _path_length(track),
        duration,
        end,
        method,
        vehicle,
        nodes,
        counts,
        outlier_windows,
        warning_lines,
        outages,
    )


def _path_length(track: WheelTrack) -> float:
    """Return the length of the track, m, backwards too; the chord across an outage."""
    chord = np.hypot(np.diff(track.x), np.diff(track.y))
    rolled_distance = np.abs(track.speed) * WINDOW_S
    is_outage = np.diff(track.t) > 1.5 * WINDOW_S
    return float(rolled_distance[0] + np.sum(np.where(is_outage, chord, rolled_distance[1:])))


def _quantities(
    wheel_filter: WheelFilter, wheel: Wheel | None, entries: Sequence[Entry]
) -> dict[str, dict[str, Quantity]]:
    """Return effect -> parameter -> value and sigma of the learnable entries, in the node's own axes."""
    result: dict[str, dict[str, Quantity]] = {}
    for entry in entries:
        if entry.is_learnable:
            quantity = wheel_filter.core.estimate(None if wheel is None else wheel.name, entry)
            factor = (1.0 if wheel is None else entry.sign(wheel.node.facing)) / entry.factor
            for parameter in entry.parameters:
                scaled = Quantity(quantity.value * factor, quantity.sigma * abs(factor))
                result.setdefault(entry.effect, {})[parameter] = scaled
    return result
