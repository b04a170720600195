"""A recording of wheel nodes to a track, with what was learnt on the way and what a user must know."""

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
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeeds
from hubodo.fuse.wheel.window import WINDOW_S
from hubodo.recording import Table
from hubodo.vehicle import side_sign

_DISAGREE = 10
"""Windows in which the wheels roll apart, a second of them, after which a clock is doubted. Estimated."""


@dataclass(frozen=True, eq=False)
class WheelTrack:
    """Poses of the body origin, each (N,).

    t: s on the log's clock. x, y: m from the start; heading: rad, unwrapped. speed: m/s and yaw_rate: rad/s,
    means of the tenth of a second that ends at t. covariance: (N, 5, 5) of x, y, heading, speed, yaw_rate.
    still: 0 moving, 1 rocking, 2 at rest. nis, degrees: of each step. carrying: 1 where no wheel told the
    speed.
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
        """The same as the common track: sigmas instead of covariances."""
        sigma = np.sqrt(np.maximum(np.einsum("nii->in", self.covariance), 0.0))
        x, y, heading = sigma[:3]
        return Track(self.t, self.x, self.y, self.heading, self.speed, x, y, heading, self.yaw_rate)


@dataclass(frozen=True)
class WheelReport:
    """What the filter learnt.

    distance: m along the track. duration: s. end: s, of the last pose. method: in words. vehicle, and nodes
    by name: effect -> parameter -> value and sigma, as a calibration file has them, nodes in their own axes;
    what one wheel cannot show is not there. What the filter knows as a mean of two parameters, each has.
    counts: by node, windows in which it slipped, clipped, was not heard; samples refused. slips: by node, the
    times in which its wheel spun by itself. warnings: one line each, of everything else. silences: when no
    wheel was heard, s, and whether the vehicle stood.
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
        """For fuse.json."""
        return {
            "distance": self.distance,
            "duration": self.duration,
            "method": self.method,
            "vehicle": _plain(self.vehicle),
            "nodes": {name: _plain(effects) for name, effects in self.nodes.items()},
            "counts": {name: dict(value) for name, value in self.counts.items()},
            "silences": [
                {"begin": outage.start, "end": outage.end, "stood": outage.was_stationary}
                for outage in self.outages
            ],
            "slips": [
                {"node": name, "from": slip.begin, "to": min(slip.end, self.end), "speed": slip.speed}
                for name, slips in self.slips.items()
                for slip in slips
            ],
            "warnings": [
                *(f"{name}: {slip.description}" for name, slips in self.slips.items() for slip in slips),
                *self.warnings,
            ],
        }


def _plain(effects: Mapping[str, Mapping[str, Quantity]]) -> dict[str, dict[str, dict[str, float]]]:
    return {name: {key: asdict(item) for key, item in found.items()} for name, found in effects.items()}


@dataclass(frozen=True, eq=False)
class WheelRun:
    """A whole recording, filtered."""

    track: WheelTrack
    report: WheelReport
    filter: WheelFilter = field(repr=False)

    def with_warning(self, line: str) -> WheelRun:
        """The same, with one more warning, before the others."""
        return replace(self, report=replace(self.report, warnings=(line, *self.report.warnings)))


def run_wheel_filter(
    config: WheelConfig, nodes: Mapping[str, Table], lag: float = 0.0, speeds: SurfaceSpeeds | None = None
) -> WheelRun:
    """Track of the nodes in `config` that `nodes` holds, columns t, gx, gy, gz, ax, ay, az.

    lag: s of what came after a pose that it is made from, too; inf: the whole log. The time it takes grows
    with a finite lag; one as long as the log is the same as inf, up to rounding. speeds: of another odometer,
    where the config has an encoder. Raises ValueError when there is not one window: less than a fifth of a
    second of samples.
    """
    made = WheelFilter(config, speeds)
    if lag > 0.0:
        made.recorded_steps = []
    blocks = {
        name: (nodes[name].t, nodes[name].gyro, nodes[name].accel) for name in config.nodes if name in nodes
    }
    poses = [*made.handle_many(blocks).poses, *made.finish().poses]
    if not poses:
        raise ValueError("the nodes have less than a fifth of a second of samples: nothing to filter")

    def again(nodes: Mapping[str, Table], config: WheelConfig = config) -> WheelRun:
        return run_wheel_filter(config, nodes, lag, speeds)

    alone = _without_what_jumped(nodes, made, again) or _without_what_contradicts(nodes, made, again)
    if alone is not None:
        return alone
    steps = made.recorded_steps or []
    if lag >= len(steps) * WINDOW_S > 0.0:
        poses = smoother.smooth_whole_log(config, steps, ALIGNMENT_WINDOWS, made.core.slip_schedule)
    elif lag > 0.0:
        ahead = math.ceil(lag / WINDOW_S - 1e-9)
        poses = smooth_with_lag(config, steps, ALIGNMENT_WINDOWS, ahead, made.core.slip_schedule)
    track = track_from_poses(poses)
    if len(made.core.wheels) == 1 and rolled_mostly_backwards(made.core.wheels[0]):
        track = replace(track, covariance=_mirrored(track))
    return WheelRun(track, build_report(made, track, lag), made)


def _without_what_jumped(
    nodes: Mapping[str, Table], made: WheelFilter, again: Callable[..., WheelRun]
) -> WheelRun | None:
    """The run without what came after a gap in one node alone, when since then the wheels disagree.

    Then its clock jumped against the other's, by what cannot be told. None where all is well: samples lost in
    between leave wheels that agree.
    """
    slips = sum(wheel.outlier_windows for wheel in made.core.wheels)
    gaps = find_own_gaps([nodes[name] for name in made.config.nodes if name in nodes])
    contradict = made.core.mounting_check.usable_side != 0.0
    if (slips < _DISAGREE and not contradict) or len(gaps) != 2 or all(gaps) or not any(gaps):
        return None
    name, t = next((name, gap[0]) for name, gap in zip(made.config.nodes, gaps, strict=True) if gap)
    table = nodes[name]
    before = Table({key: column[table.t <= t] for key, column in table.columns.items()})
    found = again({**nodes, name: before})
    earlier = sum(wheel.outlier_windows for wheel in found.filter.core.wheels)
    agreed = contradict and found.filter.core.mounting_check.usable_side == 0.0
    if slips - earlier < _DISAGREE + earlier and not agreed:
        return None
    return found.with_warning(
        f"{name}: its clock jumped at t = {t:.1f} s; what came then is left out, sigmas grow there"
    )


def _without_what_contradicts(
    nodes: Mapping[str, Table], made: WheelFilter, again: Callable[..., WheelRun]
) -> WheelRun | None:
    """The run of one wheel, from its start, where the two are not an axle; None where they are."""
    agreement, wheels = made.core.mounting_check, made.core.wheels
    if not agreement.usable_side:
        return None
    runs = {
        wheel.name: again(
            nodes, replace(made.config, nodes={wheel.name: _moved(wheel.node, agreement.sides_swapped)})
        )
        for wheel in wheels
        if agreement.other_wheel_steers or side_sign(wheel.node.side) == agreement.usable_side
    }
    # Each by itself feels its own yaw rate; what a wheel steers comes on top of the vehicle's turning.
    name = min(runs, key=lambda one: float(np.sum(runs[one].track.yaw_rate ** 2)))
    more = "".join(f"; {one} turns more than {name}" for one in runs if one != name)
    return runs[name].with_warning(f"{agreement.verdict}{more}; the track comes from {name} alone")


def _moved(node: WheelNode, exchanged: bool) -> WheelNode:
    """The node, on the other side where the two are exchanged."""
    if not exchanged:
        return node
    return replace(node, side="right" if node.side == "left" else "left")


def _mirrored(track: WheelTrack) -> Array:
    """(N, 5, 5): what the track does not know when it may as well be its own mirror image.

    Had the node the other facing, the vehicle would drive forwards with the same headings: every place is
    that of the start less the way to it.
    """
    away = np.zeros((len(track.t), 5))
    away[:, 0], away[:, 1], away[:, 3] = 2.0 * track.x, 2.0 * track.y, 2.0 * track.speed
    return np.asarray(track.covariance + away[:, :, None] * away[:, None, :])


def track_from_poses(poses: Sequence[Pose]) -> WheelTrack:
    """Poses as arrays."""
    plain = np.array([pose[:6] for pose in poses], np.float64)
    t, x, y, heading, speed, yaw_rate = (np.ascontiguousarray(column) for column in plain.T)
    covariance = np.array([pose.covariance for pose in poses])
    still = np.array([pose.motion_state for pose in poses], np.float64)
    nis = np.array([pose.nis for pose in poses])
    degrees = np.array([pose.dof for pose in poses], np.float64)
    carrying = np.array([pose.inertial_speed for pose in poses], np.float64)
    return WheelTrack(t, x, y, heading, speed, yaw_rate, covariance, still, nis, degrees, carrying)


def build_report(made: WheelFilter, track: WheelTrack, lag: float = 0.0) -> WheelReport:
    """What a filter knows after its last pose; lag: as for `run`."""
    wheels = made.core.wheels
    names = " and ".join(wheel.name for wheel in wheels)
    how = "filtered, each pose from the past alone"
    if lag > 0.0:
        ahead = f"what came up to {lag:g} s after it" if math.isfinite(lag) else "the whole log"
        how = f"smoothed, each pose from {ahead}: not causal"
    seen = [entry for entry in VEHICLE_ENTRIES if len(wheels) == 2 or entry not in OBSERVABLE_WITH_TWO_WHEELS]
    vehicle = _quantities(made, None, seen)
    nodes = {wheel.name: _quantities(made, wheel, WHEEL_ENTRIES) for wheel in wheels}
    counts = {
        wheel.name: {
            "windows_slipping": wheel.outlier_windows + made.core.slip_schedule.count_windows(index),
            "windows_clipped": wheel.clipped_windows,
            "windows_unheard": wheel.missing_windows,
            "samples_refused": made.refused[wheel.name],
        }
        for index, wheel in enumerate(wheels)
    }
    slips = {wheel.name: tuple(wheel.slip_detector.slips) for wheel in wheels if wheel.slip_detector.slips}
    duration, end = float(track.t[-1] - track.t[0]) + WINDOW_S, float(track.t[-1])
    warned = tuple(list_warnings(made, track.motion_state))
    silences = tuple(made.core.outages.listed)
    told = " with the surface speeds of another odometer" if made.config.encoder_aided else ""
    method = f"wheel filter on {names}{told}, {how}"
    return WheelReport(_path(track), duration, end, method, vehicle, nodes, counts, slips, warned, silences)


def _path(track: WheelTrack) -> float:
    """m along the track, backwards too; over a silence the chord."""
    chord = np.hypot(np.diff(track.x), np.diff(track.y))
    rolled = np.abs(track.speed) * WINDOW_S
    silent = np.diff(track.t) > 1.5 * WINDOW_S
    return float(rolled[0] + np.sum(np.where(silent, chord, rolled[1:])))


def _quantities(
    made: WheelFilter, wheel: Wheel | None, entries: Sequence[Entry]
) -> dict[str, dict[str, Quantity]]:
    """Effect -> parameter -> value and sigma of the entries that a drive can teach.

    They are in the node's own axes.
    """
    found: dict[str, dict[str, Quantity]] = {}
    for entry in entries:
        if entry.is_learnable:
            quantity = made.core.estimate(None if wheel is None else wheel.name, entry)
            share = (1.0 if wheel is None else entry.sign(wheel.node.facing)) / entry.factor
            for parameter in entry.parameters:
                same = Quantity(quantity.value * share, quantity.sigma * abs(share))
                found.setdefault(entry.effect, {})[parameter] = same
    return found
