"""What a drive with known positions tells about wheels and nodes: the wheel filter, told where it was."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import CalibratedEffect, Quantity
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel import phase
from hubodo.fuse.wheel.config import WheelConfig, WheelNode, WheelPrior
from hubodo.fuse.wheel.filter import START, Step, WheelFilter
from hubodo.fuse.wheel.step import Pose, WheelStep
from hubodo.fuse.wheel.track import collect, report
from hubodo.recording import Table
from hubodo.vehicle import facing_sign

WIDE = WheelPrior(radius=0.05, yaw_scale=0.02, spin_scale=0.02)
"""What is believed before a calibration: radius to 5 %, scales to 2 %."""

WIDE_TRACK = 0.1

_SEEN = 0.5
_ALIGN_DISTANCE = 5.0

# What the filter's model leaves out, 1 sigma: a tilt is seen through a gyro whose scale is known to 1 %; a
# bias moves with temperature and gravity between the seconds it was seen in; the scale of the two axes
# across is one number.
_TILT_SHARE, _BIAS_FLOOR, _SCALE_FLOOR = 0.015, 4e-4, 5e-4


@dataclass(frozen=True)
class WheelCalibration:
    """nodes: name -> effect -> parameter -> value and sigma, names of the model file, node's own axes.
    vehicle: the same. unseen: what the drive did not show, one line each, with what would. rms: m between
    the fixes and the track that the filter made before it was told them. fixes: how many were used.
    warnings: as of the filter."""

    nodes: Mapping[str, Mapping[str, Mapping[str, Quantity]]]
    vehicle: Mapping[str, Mapping[str, Quantity]]
    unseen: tuple[str, ...]
    rms: float
    fixes: int
    warnings: tuple[str, ...]

    def effects(self, name: str, **provenance: object) -> dict[str, CalibratedEffect]:
        """The effects of one node for a calibration file; provenance: further fields of CalibratedEffect."""
        return _effects(self.nodes[name], provenance)

    def vehicle_effects(self, **provenance: object) -> dict[str, CalibratedEffect]:
        """Those of the vehicle."""
        return _effects(self.vehicle, provenance)


@dataclass(frozen=True)
class _Parameter:
    """A parameter of the calibration file and the state it is read from; turned: its sign follows the
    facing."""

    effect: str
    name: str
    state: int
    turned: bool
    remedy: str
    negated: bool = False


_TURN = "drive on: the wheel must turn many times"
_CURVES = "drive curves: turns that add up to well over 180 degrees, to both sides"
_PARAMETERS = (
    _Parameter("wheel_radius", "error", phase.RADIUS, False, "drive farther, or with better positions"),
    _Parameter("lever_arm", "x", phase.ARM_X, False, "drive faster, or brake and accelerate"),
    _Parameter("lever_arm", "y", phase.ARM_Y, True, "drive faster, or brake and accelerate"),
    _Parameter("node_misalignment", "x", phase.TILT_Y, False, _TURN),
    _Parameter("node_misalignment", "y", phase.TILT_X, True, _TURN, negated=True),
    _Parameter("gyro_bias", "x", phase.BIAS_X, False, _TURN),
    _Parameter("gyro_bias", "y", phase.BIAS_Y, True, _TURN),
    _Parameter(
        "gyro_bias", "z", phase.SPIN_BIAS, True, "stand still for ten seconds, and drive at several speeds"
    ),
    _Parameter("gyro_scale_factor", "z", phase.SPIN_SCALE, False, _TURN),
    _Parameter("gyro_scale_factor", "x", phase.YAW_SCALE, False, _CURVES),
    _Parameter("gyro_scale_factor", "y", phase.YAW_SCALE, False, _CURVES),
)


def calibrate_wheels(
    config: WheelConfig,
    nodes: Mapping[str, Table],
    t: Array,
    x: Array,
    y: Array,
    sigma: Array,
) -> WheelCalibration:
    """Runs the filter with wide priors over the log and gives it the positions.

    t: (M,) s, increasing; x, y: (M,) m, east and north; sigma: (M,) m, 1 sigma in each direction. A parameter
    counts as seen where its sigma fell below half of what was believed before. The scale of the two gyros
    across the axle is seen as their mean only; x and y both carry it.

    Raises CalibrationError: fewer than ten positions in the time of the nodes, or a drive shorter than 10 m.
    """
    wide = {
        name: WheelNode(node.side, node.facing, WIDE) for name, node in config.nodes.items() if name in nodes
    }
    if not wide:
        raise CalibrationError("none of the vehicle's wheel nodes is in the log; check the names in [nodes]")
    config = replace(config, nodes=wide, track_error=0.0, track_sigma=WIDE_TRACK)
    first = WheelFilter(config)
    first.steps = []
    blocks = {name: (nodes[name].t, nodes[name].gyro, nodes[name].accel) for name in wide}
    poses = [*first.handle_many(blocks).poses, *first.finish().poses]
    inside = (t >= poses[0].t) & (t <= poses[-1].t) if poses else np.zeros(len(t), bool)
    t, x, y, sigma = t[inside], x[inside], y[inside], sigma[inside]
    if len(t) < 10:
        raise CalibrationError(f"{len(t)} positions in the time of the nodes; at least ten are needed")
    heading, rms = _align(poses, t, x, y, sigma)
    config = replace(config, start_heading=heading, heading_sigma=0.2)
    core, fixes = _told(config, first.steps, t, x, y, sigma)
    return _result(core, WheelStep(config), rms, fixes, report(first, collect(poses)).warnings)


def _align(poses: list[Pose], t: Array, x: Array, y: Array, sigma: Array) -> tuple[float, float]:
    """Heading at the start under which the track lies on the positions, and the rms distance left, m.

    The angle is taken over the first part that is long against the positions' noise: later the track has
    drifted.
    """
    track = collect(poses)
    at_x, at_y = np.interp(t, track.t, track.x), np.interp(t, track.t, track.y)
    way = np.hypot(x - x[0], y - y[0])
    reach = max(_ALIGN_DISTANCE, 10.0 * float(np.median(sigma)))
    if way.max() < 10.0 or way.max() < reach:
        raise CalibrationError(
            f"the positions reach {way.max():.1f} m from the start; drive {max(10.0, reach):.0f} m away"
        )
    upto = int(np.argmax(way > reach)) + 1
    ours = (at_x[:upto] - at_x[0]) + 1j * (at_y[:upto] - at_y[0])
    theirs = (x[:upto] - x[0]) + 1j * (y[:upto] - y[0])
    heading = float(np.angle(np.sum(theirs * ours.conj())))
    turned = (at_x + 1j * at_y) * np.exp(1j * heading)
    error = (x + 1j * y) - turned
    error -= error.mean()
    return heading, float(np.sqrt(np.mean(np.abs(error) ** 2)))


def _told(
    config: WheelConfig, steps: list[Step], t: Array, x: Array, y: Array, sigma: Array
) -> tuple[WheelStep, int]:
    """The filter again, with the position nearest to the end of each window."""
    core = WheelStep(config)
    # The first position sets the origin; how well it is known is how well the filter's start is known.
    origin = float(sigma[0])
    core.p[phase.X, phase.X] = core.p[phase.Y, phase.Y] = origin**2 + 1e-6
    core.x[phase.X], core.x[phase.Y] = float(x[0]), float(y[0])
    core.begin([step.windows for step in steps if not step.listen])
    used, place = 0, 0
    for step in steps:
        pose = core.step(step.windows, step.number, step.listen, START)
        for index in _until(t, place, pose.t):
            place = index + 1
            late = pose.t - float(t[index])
            back_x = float(x[index]) + pose.speed * late * np.cos(pose.heading)
            back_y = float(y[index]) + pose.speed * late * np.sin(pose.heading)
            core.fix(back_x, back_y, float(np.hypot(sigma[index], 0.02 * abs(pose.speed * late) + 1e-3)))
            used += 1
    return core, used


def _until(t: Array, place: int, end: float) -> Iterator[int]:
    while place < len(t) and t[place] <= end:
        yield place
        place += 1


def _result(
    core: WheelStep, before: WheelStep, rms: float, fixes: int, warnings: tuple[str, ...]
) -> WheelCalibration:
    nodes: dict[str, dict[str, dict[str, Quantity]]] = {}
    unseen = []
    for wheel in core.wheels:
        mine = nodes.setdefault(wheel.name, {})
        sign = facing_sign(wheel.node.facing)
        for parameter in _PARAMETERS:
            value, sigma = core.estimate(wheel.name, parameter.state)
            prior = before.estimate(wheel.name, parameter.state)[1]
            if sigma > _SEEN * prior:
                label = f"{wheel.name}.{parameter.effect}.{parameter.name}"
                unseen.append(f"{label}: {sigma:.2g} after the drive, {prior:.2g} before; {parameter.remedy}")
                continue
            factor = (sign if parameter.turned else 1.0) * (-1.0 if parameter.negated else 1.0)
            quantity = Quantity(factor * value, math.hypot(sigma, _left_out(parameter.effect, value)))
            mine.setdefault(parameter.effect, {})[parameter.name] = quantity
    vehicle = {}
    if len(core.wheels) == 2:
        value, sigma = core.estimate(None, phase.TRACK)
        if sigma <= _SEEN * WIDE_TRACK:
            vehicle["track_width"] = {"error": Quantity(value, sigma)}
        else:
            unseen.append(f"vehicle.track_width.error: {sigma:.2g} after the drive; {_CURVES}")
    else:
        unseen.append("vehicle.track_width.error: one node does not show it; put nodes on both wheels")
    return WheelCalibration(nodes, vehicle, tuple(unseen), rms, fixes, warnings)


def _left_out(effect: str, value: float) -> float:
    floors = {"node_misalignment": _TILT_SHARE * abs(value) + 1e-4, "gyro_bias": _BIAS_FLOOR}
    return floors.get(effect, _SCALE_FLOOR if effect == "gyro_scale_factor" else 0.0)


def _effects(
    found: Mapping[str, Mapping[str, Quantity]], provenance: Mapping[str, object]
) -> dict[str, CalibratedEffect]:
    return {name: CalibratedEffect(parameters, **provenance) for name, parameters in found.items()}  # type: ignore[arg-type]
