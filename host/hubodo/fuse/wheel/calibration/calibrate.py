"""What a drive with known positions tells about wheels and nodes: the wheel filter, told where it was."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hubodo.calibration.file import CalibratedEffect, Quantity
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.calibration.aided_filter import AidedRun, run_aided_filter
from hubodo.fuse.wheel.calibration.alignment import align_heading, check_axes, rotated_track_at
from hubodo.fuse.wheel.calibration.held_out import Antenna, HeldOutErrors, measure_held_out_errors
from hubodo.fuse.wheel.calibration.learnt_parameters import LearntParameters, extract_parameters
from hubodo.fuse.wheel.calibration.positions import Positions, estimate_white_sigma
from hubodo.fuse.wheel.config import WheelConfig, WheelNode, priors_from_calibration
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
from hubodo.fuse.wheel.records import Pose, StepInput
from hubodo.fuse.wheel.track import WheelTrack, build_report, track_from_poses
from hubodo.recording import Table

_SLOW, _SIZES, _FIRST_GUESS = 0.03, 11, 3
"""m; the smallest size of what changes slowly in positions; how many that double are looked at; the first."""

_UNLIKELY = 6.0
"""By how much minus twice a log likelihood is above its best where something is unlikely: 1 in 70."""

_SECONDS = 1.0
"""s; of positions that come more often one in so many is used: their errors hardly change meanwhile."""

_HEADING_SIGMA = 0.2
"""rad; how far the heading may be off that the first metres of the positions show. Estimated."""


@dataclass(frozen=True)
class WheelPriors:
    """What is believed before a drive, 1 sigma, as fractions.

    radius: a tape measure around a tyre that is loaded. track: between the middles of two tyres. scale: of a
    gyro, by the data sheets of MEMS gyros.
    """

    radius: float = 0.02
    track: float = 0.03
    scale: float = 0.01


@dataclass(frozen=True)
class WheelCalibration:
    """What a drive with known positions told.

    nodes: name -> effect -> parameter -> value and sigma, names of the model file, node's own axes.
    vehicle: the same. unseen: what the drive did not show, one line each, with what would. antenna: x and y
    in the vehicle, m. rms: m between the positions and the track that the filter made before it was told
    them. held_out: on stretches that were left out. random, slow: m, 1 sigma of the positions' errors, as
    they show it. fixes: how many were used; jumps: how many jumped. warnings: as of the filter.
    """

    nodes: Mapping[str, Mapping[str, Mapping[str, Quantity]]]
    vehicle: Mapping[str, Mapping[str, Quantity]]
    not_observable: tuple[str, ...]
    antenna: tuple[Quantity, Quantity]
    rms: float
    held_out: HeldOutErrors
    white_sigma: float
    slow_sigma: float
    n_positions: int
    n_jumps: int
    warnings: tuple[str, ...]

    def effects(self, name: str, **provenance: object) -> dict[str, CalibratedEffect]:
        """The effects of one node for a calibration file; provenance: further fields of CalibratedEffect."""
        return _effects(self.nodes[name], provenance)

    def vehicle_effects(self, **provenance: object) -> dict[str, CalibratedEffect]:
        """Those of the vehicle."""
        return _effects(self.vehicle, provenance)


def calibrate_wheels(
    config: WheelConfig, nodes: Mapping[str, Table], positions: Positions, priors: WheelPriors | None = None
) -> WheelCalibration:
    """Runs the filter with wide priors over the log and tells it the positions.

    A parameter counts as seen where its sigma fell below half of what was believed before. The scale of the
    two gyros across the axle is seen as their mean only; x and y both carry it.

    Raises CalibrationError: fewer than ten positions in the time of the nodes, a drive shorter than 10 m, a
    value that cannot be, or a calibration that makes stretches worse that were left out.
    """
    drive = _Drive(config, nodes, positions, priors or WheelPriors())
    slow = drive.largest_slow_error()
    done = drive.tell(drive.told, slow)
    antenna = (done.core.estimate(None, ANTENNA_X), done.core.estimate(None, ANTENNA_Y))
    track = drive.track
    found = drive.findings(done.core)
    judged = measure_held_out_errors(
        drive.told, track, lambda told, until: drive.fitted(told, until, slow), _values(antenna)
    )
    if not judged.is_improved:
        raise CalibrationError(
            f"calibrated on the rest, stretches that were left out are no better ({judged.description}); "
            "drive farther, with turns to both sides; nothing is written"
        )
    return WheelCalibration(
        found.nodes,
        found.vehicle,
        tuple(found.not_observable),
        antenna,
        drive.rms,
        judged,
        float(np.median(drive.random)),
        slow,
        done.n_used,
        done.n_jumps,
        drive.warnings,
    )


class _Drive:
    """A log and its positions, boiled down to what every filter over it needs."""

    def __init__(
        self, config: WheelConfig, nodes: Mapping[str, Table], positions: Positions, priors: WheelPriors
    ) -> None:
        mine = {name: node for name, node in config.nodes.items() if name in nodes}
        if not mine:
            raise CalibrationError(
                "none of the vehicle's wheel nodes is in the log; check the names in [nodes]"
            )
        config = replace(config, nodes=mine)
        blocks = {name: (nodes[name].t, nodes[name].gyro, nodes[name].accel) for name in mine}
        first = WheelFilter(config)
        first.recorded_steps = []
        poses = [*first.handle_many(blocks).poses, *first.finish().poses]
        told = positions.select((positions.t >= poses[0].t) & (positions.t <= poses[-1].t)) if poses else None
        if told is None or len(told) < 10:
            count = 0 if told is None else len(told)
            raise CalibrationError(f"{count} positions in the time of the nodes; at least ten are needed")
        self.steps: Sequence[StepInput] = first.recorded_steps
        # Told where it is, a filter cannot go back to where a slip began: they are those of the drive itself.
        self.slips = first.core.slip_schedule
        self.track = track_from_poses(poses)
        self.warnings = build_report(first, self.track).warnings
        check_axes(self.track, told)
        heading = align_heading(self.track, told)
        ours = rotated_track_at(self.track, told, heading)
        error = told.x + 1j * told.y - ours
        self._origin = complex(error[0])
        self.rms = float(np.sqrt(np.mean(np.abs(error - error.mean()) ** 2)))
        random = estimate_white_sigma(told, ours.real, ours.imag)
        # Positions that come often are thinned out; all of them show what is random.
        self.told = told.thin_out(_SECONDS)
        self.random = np.interp(self.told.t, told.t, random)
        self._plain = config
        self._wide = replace(
            _known(config, *_of_priors(mine, priors)), start_heading=heading, heading_sigma=_HEADING_SIGMA
        )
        self.before = FilterCore(self._wide)

    def tell(self, told: Positions, slow: float) -> AidedRun:
        """The filter with wide priors, told positions."""
        random = np.interp(told.t, self.told.t, self.random)
        return run_aided_filter(self._wide, self.steps, told, random, slow, self._origin, self.slips)

    def largest_slow_error(self) -> float:
        """The largest size of the slow error, m, under which the positions are not unlikely.

        From a parabola through the likelihood of the likeliest size, its half and its double.
        """
        made: dict[int, float] = {}

        def cost(place: int) -> float:
            if place not in made:
                made[place] = self.tell(self.told, _SLOW * 2.0**place).cost
            return made[place]

        best = _FIRST_GUESS
        while 0 < best < _SIZES - 1:
            step = min((-1, 0, 1), key=lambda step: cost(best + step))
            if step == 0:
                break
            best += step
        else:
            return _SLOW * 2.0**best
        bend = cost(best - 1) - 2.0 * cost(best) + cost(best + 1)
        lowest = 0.5 * (cost(best - 1) - cost(best + 1)) / bend
        return float(_SLOW * 2.0 ** (best + lowest + math.sqrt(2.0 * _UNLIKELY / bend)))

    def findings(self, core: FilterCore) -> LearntParameters:
        """What a filter that was told positions knows better than before."""
        way = np.abs(np.diff(self.track.x + 1j * self.track.y))
        return extract_parameters(core, self.before, float(np.ptp(self.track.heading)), float(np.sum(way)))

    def fitted(self, told: Positions, until: float, slow: float) -> tuple[WheelTrack, Antenna]:
        """The track of a filter that was calibrated on these positions, and is not told any; its antenna.

        until: s, as far as the track is asked for.
        """
        core = self.tell(told, slow).core
        found = self.findings(core)
        nodes = {
            name: priors_from_calibration(WHEEL_ENTRIES, _effects(found.nodes[name], {}), node.facing)
            for name, node in self._plain.nodes.items()
        }
        vehicle = priors_from_calibration(VEHICLE_ENTRIES, _effects(found.vehicle, {}), "left")
        learnt = FilterCore(_known(self._plain, nodes, vehicle), self.slips)
        learnt.align([step.windows for step in self.steps if not step.realign])
        poses: list[Pose] = []
        for step in self.steps:
            poses.append(learnt.step(step, ALIGNMENT_WINDOWS))
            if poses[-1].t >= until:
                break
        antenna = (core.estimate(None, ANTENNA_X), core.estimate(None, ANTENNA_Y))
        return track_from_poses(poses), _values(antenna)


def _of_priors(
    nodes: Mapping[str, WheelNode], priors: WheelPriors
) -> tuple[dict[str, dict[Entry, Quantity]], dict[Entry, Quantity]]:
    wheel = {
        WHEEL_RADIUS: Quantity(0.0, priors.radius),
        GYRO_SCALE_ACROSS: Quantity(0.0, priors.scale),
        GYRO_SCALE_Z: Quantity(0.0, priors.scale),
    }
    return dict.fromkeys(nodes, wheel), {TRACK_WIDTH: Quantity(0.0, priors.track)}


def _known(
    config: WheelConfig, nodes: Mapping[str, Mapping[Entry, Quantity]], vehicle: Mapping[Entry, Quantity]
) -> WheelConfig:
    """The config with other priors."""
    wheels = {
        name: replace(node, priors={**node.priors, **nodes[name]}) for name, node in config.nodes.items()
    }
    return replace(config, nodes=wheels, priors={**config.priors, **vehicle})


def _values(antenna: tuple[Quantity, Quantity]) -> Antenna:
    return antenna[0].value, antenna[1].value


def _effects(
    found: Mapping[str, Mapping[str, Quantity]], provenance: Mapping[str, object]
) -> dict[str, CalibratedEffect]:
    return {name: CalibratedEffect(parameters, **provenance) for name, parameters in found.items()}  # type: ignore[arg-type]
