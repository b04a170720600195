"""Calibration of wheels and nodes: the wheel filter aided by known positions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.file import Quantity
from hubodo.errors import CalibrationError
from hubodo.fuse.track import Track
from hubodo.fuse.wheel.calibration.aided_filter import AidedRun, run_aided_filter
from hubodo.fuse.wheel.calibration.alignment import (
    align_heading,
    check_axes,
    check_distance,
    rotated_track_at,
)
from hubodo.fuse.wheel.calibration.excursions import find_excursions
from hubodo.fuse.wheel.calibration.held_out import Antenna, measure_held_out_errors
from hubodo.fuse.wheel.calibration.learnt_parameters import (
    LearntParameters,
    extract_parameters,
    quantities_as_effects,
)
from hubodo.fuse.wheel.calibration.positions import Positions, estimate_white_sigma
from hubodo.fuse.wheel.calibration.result import WheelCalibration
from hubodo.fuse.wheel.config import WheelConfig, WheelNode, priors_from_calibration
from hubodo.fuse.wheel.drive_report import build_report
from hubodo.fuse.wheel.entries import (
    ANTENNA_X,
    ANTENNA_Y,
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_Z,
    TRACK_WIDTH,
    VEHICLE_ENTRIES,
    WHEEL_ENTRIES,
    WHEEL_RADIUS,
    Entry,
)
from hubodo.fuse.wheel.filter import ALIGNMENT_WINDOWS, WheelFilter
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.node_screening import is_mirrored
from hubodo.fuse.wheel.preintegration import sample_block
from hubodo.fuse.wheel.records import Pose, StepInput
from hubodo.fuse.wheel.track import track_from_poses
from hubodo.recording import Table

_MIN_SLOW_SIGMA, _N_SLOW_SIGMAS, _FIRST_SLOW_INDEX = 0.03, 11, 3
"""m, smallest size of the slowly varying position error; number of sizes tried, each double the last; index
of the first one tried.
"""

_LIKELIHOOD_DROP = 6.0
"""Increase of -2 log likelihood above its minimum at which a size is rejected (1 in 70)."""

_MAX_JUMPS = 10
"""Jumps that any reference may have; from a short drive fewer positions are used."""

_MAX_JUMP_SHARE = 0.2
"""Share of the positions that may jump. On a real car a reference with 10 % gives the radii of its other
drives within 0.3 %, one with 38 % is 0.7 % off. Estimated."""

_POSITION_INTERVAL_S = 1.0
"""s; more frequent positions are thinned out, because their errors hardly change meanwhile."""

_START_HEADING_SIGMA = 0.2
"""rad, 1 sigma of the heading from the first metres of the positions. Estimated."""


@dataclass(frozen=True)
class WheelPriors:
    """Prior 1 sigma before a calibration drive, as fractions.

    Attributes
    ----------
    radius : tape measure around a loaded tyre.
    track : tape measure between the tyre centres.
    scale : gyro scale factor, MEMS data sheets.
    """

    radius: float = 0.02
    track: float = 0.03
    scale: float = 0.01


def calibrate_wheels(
    config: WheelConfig, nodes: Mapping[str, Table], positions: Positions, priors: WheelPriors | None = None
) -> WheelCalibration:
    """Calibrate wheels and nodes: run the filter over the log with wide priors, aided by the positions.

    A parameter counts as determined if its sigma fell below half of its prior. Only the mean scale of the
    two gyros across the axle is observable; x and y both get it.

    Raise CalibrationError: fewer than ten positions in the time of the nodes, a drive shorter than 10 m, an
    implausible value, or a calibration that does not improve held-out segments.
    """
    drive = _CalibrationDrive(config, nodes, positions, priors or WheelPriors())
    slow = drive.largest_slow_error()
    aided = drive.run_aided(drive.positions, slow)
    excursions = find_excursions(aided.jumps, drive.positions.t)
    if excursions.any():
        drive.leave_out(excursions)
        slow = drive.largest_slow_error()
        aided = drive.run_aided(drive.positions, slow)
    _check_jumps(aided)
    antenna = (aided.core.estimate(None, ANTENNA_X), aided.core.estimate(None, ANTENNA_Y))
    track = drive.track
    learnt = drive.findings(aided.core)
    held_out_errors = measure_held_out_errors(
        drive.positions,
        track,
        lambda positions_used, until: drive.fitted(positions_used, until, slow),
        _values(antenna),
    )
    if not held_out_errors.is_improved:
        raise CalibrationError(
            "calibration does not improve the held-out segments "
            f"({held_out_errors.description}); drive farther, with turns to both sides; nothing is written"
        )
    return WheelCalibration(
        learnt.nodes,
        learnt.vehicle,
        tuple(learnt.not_observable),
        antenna,
        drive.rms,
        held_out_errors,
        float(np.median(drive.random)),
        slow,
        aided.n_used,
        len(aided.jumps),
        drive.warnings,
    )


def _check_jumps(aided: AidedRun) -> None:
    """Raise CalibrationError if the positions jump too often to calibrate anything."""
    count = len(aided.jumps)
    if count > max(_MAX_JUMPS, _MAX_JUMP_SHARE * aided.n_used):
        raise CalibrationError(
            f"the positions jumped {count} times among {aided.n_used}; use a part of the drive with "
            "a steady reference, or fixes with their own sigma; nothing is written"
        )


class _CalibrationDrive:
    """A log with its positions, prepared for repeated filter runs."""

    def __init__(
        self, config: WheelConfig, nodes: Mapping[str, Table], positions: Positions, priors: WheelPriors
    ) -> None:
        used_nodes = {name: node for name, node in config.nodes.items() if name in nodes}
        if not used_nodes:
            raise CalibrationError(
                "none of the vehicle's wheel nodes is in the log; check the names in [nodes]"
            )
        config = replace(config, nodes=used_nodes)
        for name, node in used_nodes.items():
            if is_mirrored(node, nodes[name]):
                raise CalibrationError(
                    f"{name}: gravity rotates against gz: x and y of the node are exchanged, or one of them "
                    "is negated; correct its axes; nothing is written"
                )
        blocks = {name: sample_block(nodes[name]) for name in used_nodes}
        plain_filter = WheelFilter(config)
        plain_filter.recorded_steps = []
        poses = [*plain_filter.handle_blocks(blocks).poses, *plain_filter.finish().poses]
        positions_used = (
            positions.select((positions.t >= poses[0].t) & (positions.t <= poses[-1].t)) if poses else None
        )
        if positions_used is None or len(positions_used) < 10:
            count = 0 if positions_used is None else len(positions_used)
            raise CalibrationError(f"{count} positions in the time of the nodes; at least ten are needed")
        self.steps: Sequence[StepInput] = plain_filter.recorded_steps
        # A position-aided filter cannot roll back to the start of a slip: use the schedule of the plain run.
        self.slips = plain_filter.core.slip_schedule
        self.track = track = track_from_poses(poses)
        self.warnings = build_report(plain_filter, track, track.motion_state).warnings
        check_axes(self.track, positions_used)
        heading = align_heading(self.track, positions_used)
        check_distance(self.track, positions_used)
        track_points = rotated_track_at(self.track, positions_used, heading)
        error = positions_used.x + 1j * positions_used.y - track_points
        self._origin = complex(error[0])
        self.rms = float(np.sqrt(np.mean(np.abs(error - error.mean()) ** 2)))
        random = estimate_white_sigma(positions_used, track_points.real, track_points.imag)
        # All positions determine the white error; frequent ones are thinned out for the filter.
        self.positions = positions_used.thin_out(_POSITION_INTERVAL_S)
        self.random = np.interp(self.positions.t, positions_used.t, random)
        self._plain = config
        self._wide = replace(
            _with_priors(config, *_wide_priors(used_nodes, priors)),
            start_heading=heading,
            heading_sigma=_START_HEADING_SIGMA,
        )
        self.before = FilterCore(self._wide)

    def leave_out(self, excursions: NDArray[Any]) -> None:
        """Leave out the positions of a mask, (M,), with a warning."""
        count, total = int(np.sum(excursions)), len(excursions)
        self.positions, self.random = self.positions.select(~excursions), self.random[~excursions]
        self.warnings += (
            f"{count} of {total} positions jumped and returned within seconds; they are left out",
        )

    def run_aided(self, positions_used: Positions, slow: float) -> AidedRun:
        """Run the filter with wide priors, aided by positions."""
        random = np.interp(positions_used.t, self.positions.t, self.random)
        return run_aided_filter(
            self._wide, self.steps, positions_used, random, slow, self._origin, self.slips
        )

    def largest_slow_error(self) -> float:
        """Return the largest plausible size of the slowly varying error, m.

        From a parabola through -2 log likelihood at the most likely size, its half and its double.
        """
        costs: dict[int, float] = {}

        def cost(index: int) -> float:
            if index not in costs:
                costs[index] = self.run_aided(self.positions, _MIN_SLOW_SIGMA * 2.0**index).cost
            return costs[index]

        best = _FIRST_SLOW_INDEX
        while 0 < best < _N_SLOW_SIGMAS - 1:
            step = min((-1, 0, 1), key=lambda step: cost(best + step))
            if step == 0:
                break
            best += step
        else:
            return _MIN_SLOW_SIGMA * 2.0**best
        curvature = cost(best - 1) - 2.0 * cost(best) + cost(best + 1)
        minimum = 0.5 * (cost(best - 1) - cost(best + 1)) / curvature
        return float(
            _MIN_SLOW_SIGMA * 2.0 ** (best + minimum + math.sqrt(2.0 * _LIKELIHOOD_DROP / curvature))
        )

    def findings(self, core: FilterCore) -> LearntParameters:
        """Return the parameters that a position-aided filter knows better than before."""
        step_lengths = np.abs(np.diff(self.track.x + 1j * self.track.y))
        return extract_parameters(
            core, self.before, float(np.ptp(self.track.heading)), float(np.sum(step_lengths))
        )

    def fitted(self, positions_used: Positions, until: float, slow: float) -> tuple[Track, Antenna]:
        """Return track and antenna of a plain filter that was calibrated on these positions.

        until: s, end of the track.
        """
        core = self.run_aided(positions_used, slow).core
        parameters = self.findings(core)
        nodes = {
            name: priors_from_calibration(
                WHEEL_ENTRIES, quantities_as_effects(parameters.nodes[name]), node.facing
            )
            for name, node in self._plain.nodes.items()
        }
        vehicle = priors_from_calibration(VEHICLE_ENTRIES, quantities_as_effects(parameters.vehicle), "left")
        learnt = FilterCore(_with_priors(self._plain, nodes, vehicle), self.slips)
        learnt.align([step.windows for step in self.steps if not step.realign])
        poses: list[Pose] = []
        for step in self.steps:
            poses.append(learnt.step(step, ALIGNMENT_WINDOWS))
            if poses[-1].t >= until:
                break
        antenna = (core.estimate(None, ANTENNA_X), core.estimate(None, ANTENNA_Y))
        return track_from_poses(poses), _values(antenna)


def _wide_priors(
    nodes: Mapping[str, WheelNode], priors: WheelPriors
) -> tuple[dict[str, dict[Entry, Quantity]], dict[Entry, Quantity]]:
    wheel = {
        WHEEL_RADIUS: Quantity(0.0, priors.radius),
        GYRO_SCALE_ACROSS: Quantity(0.0, priors.scale),
        GYRO_SCALE_Z: Quantity(0.0, priors.scale),
    }
    return dict.fromkeys(nodes, wheel), {TRACK_WIDTH: Quantity(0.0, priors.track)}


def _with_priors(
    config: WheelConfig, nodes: Mapping[str, Mapping[Entry, Quantity]], vehicle: Mapping[Entry, Quantity]
) -> WheelConfig:
    """Return the config with the wide priors of a calibration."""
    wheels = {
        name: replace(node, priors={**node.priors, **nodes[name]}) for name, node in config.nodes.items()
    }
    return replace(config, nodes=wheels, priors={**config.priors, **vehicle})


def _values(antenna: tuple[Quantity, Quantity]) -> Antenna:
    return antenna[0].value, antenna[1].value
