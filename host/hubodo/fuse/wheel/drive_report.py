"""Report of a drive: learnt parameters, counts, slips, outages, and warnings for the user."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.track import Track
from hubodo.fuse.wheel.entries import (
    OBSERVABLE_WITH_TWO_WHEELS,
    TRACK_WIDTH,
    VEHICLE_ENTRIES,
    WHEEL_ENTRIES,
    WHEEL_RADIUS,
    Entry,
)
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_log import WheelOutage
from hubodo.fuse.wheel.slip_detector import Slip
from hubodo.fuse.wheel.thresholds import DETECTION_WINDOWS, GATE_SIGMA
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.fuse.wheel.window import WINDOW_S, WINDOWS_PER_SECOND

START_WINDOWS = DETECTION_WINDOWS
"""Windows at the start in which a standstill is expected; later it counts only if there was one at all."""
_FULL_TURN = 2.0 * math.pi
_MIN_EARTH_TURN = math.radians(0.5)
"""rad, 1 sigma of the heading by an unknown rotation of the Earth from which on it is reported: as much as a
good gyro leaves in a drive."""


@dataclass(frozen=True)
class WheelReport:
    """Report of a drive: parameters learnt, counts, slips, outages and warnings.

    Attributes
    ----------
    distance : m along the track.
    duration, end : s; end is the time of the last pose.
    method : sentence.
    vehicle, nodes : effect -> parameter -> value and sigma as in a calibration file, nodes by name and in
    their own axes. Entries that one wheel cannot observe are left out; a mean of two parameters is listed
    for both.
    counts : by node, numbers of windows slipping, clipped and missing, and of samples rejected.
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


def build_report(
    wheel_filter: WheelFilter, track: Track, motion_states: Array, lag: float = 0.0
) -> WheelReport:
    """Return the report of a filter after its last pose.

    track: all poses. motion_states: (N,) motion state of each pose. lag: as in `run_wheel_filter`.
    """
    wheels = wheel_filter.core.wheels
    names = " and ".join(wheel.name for wheel in wheels)
    causality = "forward filter: each pose from past samples only"
    if lag > 0.0:
        ahead = f"samples up to {lag:g} s after it" if math.isfinite(lag) else "the whole log"
        causality = f"smoothed: each pose from {ahead}, not causal"
    observable = [
        entry for entry in VEHICLE_ENTRIES if len(wheels) == 2 or entry not in OBSERVABLE_WITH_TWO_WHEELS
    ]
    vehicle = _quantities(wheel_filter, None, observable)
    nodes = {wheel.name: _quantities(wheel_filter, wheel, WHEEL_ENTRIES) for wheel in wheels}
    counts = {
        wheel.name: {
            "windows_slipping": wheel.counts.outlier_windows
            + wheel_filter.core.slip_schedule.count_windows(index),
            "windows_clipped": wheel.counts.clipped_windows,
            "windows_unheard": wheel.counts.missing_windows,
            "samples_refused": wheel_filter.rejected_samples[wheel.name],
        }
        for index, wheel in enumerate(wheels)
    }
    outlier_windows = {
        wheel.name: tuple(wheel.slip_detector.slips) for wheel in wheels if wheel.slip_detector.slips
    }
    duration, end = float(track.t[-1] - track.t[0]) + WINDOW_S, float(track.t[-1])
    warning_lines = tuple(list_warnings(wheel_filter, motion_states))
    outages = tuple(wheel_filter.core.outages.listed_outages)
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


def _path_length(track: Track) -> float:
    """Return the length of the track, m; driving backwards counts too, an outage as a straight line."""
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
            if entry is WHEEL_RADIUS:
                sigma = math.hypot(quantity.sigma, wheel_filter.core.common_scale_sigma)
                quantity = Quantity(quantity.value, sigma)
            factor = (1.0 if wheel is None else entry.sign(wheel.node.facing)) / entry.factor
            for parameter in entry.parameters:
                scaled = Quantity(quantity.value * factor, quantity.sigma * abs(factor))
                result.setdefault(entry.effect, {})[parameter] = scaled
    return result


def list_warnings(wheel_filter: WheelFilter, motion_states: Array) -> list[str]:
    """Return one line for each warning; motion_states: (N,) of the poses."""
    lines = []
    start = motion_states[:START_WINDOWS]
    if not np.any(start != MotionState.MOVING):
        lines.append(
            "no rest at the start: gyro biases had to be found while driving; the heading is less sure for "
            "the first turns of the wheel. Stand still for five seconds before driving off"
        )
    elif not np.any(start == MotionState.STANDSTILL) and not np.any(motion_states == MotionState.STANDSTILL):
        lines.append("the vehicle was rocked at the start, never quite still: gyro biases are less sure")
    if wheel_filter.config.ground_rate_sigma * wheel_filter.core.windows * WINDOW_S > _MIN_EARTH_TURN:
        lines.append(
            "the latitude is unknown: the heading keeps the rotation of the Earth, up to 0.25° a minute, and "
            "its sigma counts it; set latitude_deg under [vehicle]"
        )
    if wheel_filter.core.mounting_check.verdict:
        lines.append(f"{wheel_filter.core.mounting_check.verdict}; until then its speed is not used")
    lines += _track_width_warnings(wheel_filter)
    lines += wheel_filter.core.outages.list_warnings(
        " and ".join(wheel.name for wheel in wheel_filter.core.wheels)
    )
    windows, outage_windows = wheel_filter.core.windows, wheel_filter.core.outages.windows
    for wheel in wheel_filter.core.wheels:
        rejected = wheel_filter.rejected_samples[wheel.name], wheel_filter.glitches[wheel.name]
        lines += _wheel_warnings(wheel, windows, outage_windows, *rejected)
    return lines


def _track_width_warnings(wheel_filter: WheelFilter) -> list[str]:
    """Return a warning if the track width of the drive differs from that of the vehicle file."""
    if len(wheel_filter.core.wheels) < 2:
        return []
    error, declared = wheel_filter.core.estimate(None, TRACK_WIDTH), wheel_filter.config.track_width
    prior = wheel_filter.config.priors.get(TRACK_WIDTH, Quantity(0.0, TRACK_WIDTH.prior))
    if abs(error.value - prior.value) < GATE_SIGMA * prior.sigma:
        return []
    return [
        f"track_width: speeds and gyros show {declared * (1.0 + error.value):.3g} m instead of {declared:g} m"
        f" ({error.value:+.0%} ± {error.sigma:.1%}); correct it in the vehicle file, or state "
        "steered = true if these wheels steer"
    ]


def _wheel_warnings(
    wheel: Wheel, windows: int, outage_windows: int, n_rejected: int, n_glitches: int
) -> list[str]:
    """Return the warnings of one wheel; n_glitches: rejected samples whose rate jumped and returned."""
    duration, counts = windows * WINDOW_S, wheel.counts
    if counts.missing_windows >= windows:
        return [f"{wheel.name}: no samples; the track comes from the other wheel alone"]
    wheel_lines = []
    if counts.missing_windows - outage_windows > 5:
        missing_time = counts.missing_windows * WINDOW_S
        wheel_lines.append(f"not heard for {missing_time:.1f} s of {duration:.1f} s; sigmas grow there")
    if counts.angle_losses:
        wheel_lines.append(
            f"the wheel angle was lost over a gap and reinitialised ({counts.angle_losses} times): "
            "its clock jumped, or it turned on while it was not heard"
        )
    if n_glitches:
        wheel_lines.append(
            f"{n_glitches} samples left out because their rate jumps and returns faster than a wheel turns, "
            "as after bit errors; check the wiring of the sensor"
        )
    if n_rejected > n_glitches:
        wheel_lines.append(
            f"{n_rejected - n_glitches} samples left out because their time went back, or jumped ahead for "
            "one of them"
        )
    if counts.turned_angle < _FULL_TURN:
        turns = counts.turned_angle / _FULL_TURN
        wheel_lines.append(f"the wheel turned only {turns:.2f} times; scale, tilt and lever arm stay unknown")
    elif rolled_mostly_backwards(wheel):
        wheel_lines.append(
            "rolled backwards nearly all the way; if the vehicle drove forwards, the node faces the other "
            "way: change its facing"
        )
    if counts.upright_count >= 50 and counts.upright_sum < 0.5 * counts.upright_count:
        wheel_lines.append(
            "gravity does not turn with gz; an axis is mirrored, or the node is not on the wheel"
        )
    if counts.clipped_windows:
        clipped_time = counts.clipped_windows * WINDOW_S
        wheel_lines.append(
            f"gz at its limit for {clipped_time:.1f} s; spin there is from gravity and centripetal force"
        )
    if counts.blind_windows > WINDOWS_PER_SECOND:
        wheel_lines.append(
            "gz and the accelerometers across the axle at their limits together for "
            f"{counts.blind_windows * WINDOW_S:.1f} s: nothing measures the spin there; mount the node "
            "nearer to the axle, or with its x or y axis pointing to the axle, or use wider ranges"
        )
    if counts.outlier_windows > max(5, 0.05 * windows):
        outlier_time = counts.outlier_windows * WINDOW_S
        wheel_lines.append(f"disagreed with the other wheel for {outlier_time:.1f} s and lost weight: slip?")
    return [f"{wheel.name}: {line}" for line in wheel_lines]


def rolled_mostly_backwards(wheel: Wheel) -> bool:
    """Return True if a wheel rolled backwards on nearly the whole path, as with a wrong facing."""
    return (
        wheel.counts.turned_angle >= _FULL_TURN and wheel.counts.net_angle < -0.8 * wheel.counts.turned_angle
    )
