"""What a drive with known positions tells about wheels and nodes: the wheel filter, told where it was."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import CalibratedEffect, Quantity
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import (
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_Z,
    OF_WHEEL,
    TRACK_WIDTH,
    WHEEL_RADIUS,
    Entry,
    X,
    Y,
)
from hubodo.fuse.wheel.filter import LISTENED, Step, WheelFilter
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.step import Pose, WheelStep
from hubodo.fuse.wheel.track import collect, report
from hubodo.recording import Table

_WIDE = {
    WHEEL_RADIUS: Quantity(0.0, 0.05),
    GYRO_SCALE_ACROSS: Quantity(0.0, 0.02),
    GYRO_SCALE_Z: Quantity(0.0, 0.02),
}
"""What is believed of a wheel before a calibration: its radius by eye, scales worse than any data sheet."""

_WIDE_TRACK = {TRACK_WIDTH: Quantity(0.0, 0.1)}
"""The same of the track: 10 %, by eye."""

_SEEN = 0.5
"""A parameter counts as seen where its sigma fell below this share of what was believed before."""

_ALIGN_DISTANCE = 5.0
"""m of the drive by which the track is laid on the positions, where these are exact.

So far a filter that knows nothing drifts by less than a centimetre. Estimated.
"""

_OFF, _SPEED_SHARE = 1e-3, 0.02
"""m by which the start and each position are off beside their own sigma; and a share of the speed.

The share is for the way from the end of a window back to the position within it. Estimated.
"""

_TILT_SHARE, _BIAS_FLOOR, _SCALE_FLOOR = 0.015, 4e-4, 5e-4
"""What the filter's model leaves out, 1 sigma, found on simulated drives.

A share of a tilt, which is seen through a gyro whose scale is known to 1 %; rad/s by which a bias moves with
temperature and gravity between the seconds it was seen in; a fraction, because the scale of the two axes
across is one number.
"""


@dataclass(frozen=True)
class WheelCalibration:
    """What a drive with known positions told.

    nodes: name -> effect -> parameter -> value and sigma, names of the model file, node's own axes.
    vehicle: the same. unseen: what the drive did not show, one line each, with what would. rms: m between
    the fixes and the track that the filter made before it was told them. fixes: how many were used.
    warnings: as of the filter.
    """

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
        name: WheelNode(node.side, node.facing, _WIDE) for name, node in config.nodes.items() if name in nodes
    }
    if not wide:
        raise CalibrationError("none of the vehicle's wheel nodes is in the log; check the names in [nodes]")
    config = replace(config, nodes=wide, known={**config.known, **_WIDE_TRACK})
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
    for entry, value in ((X, x[0]), (Y, y[0])):
        place = core.columns.vehicle[entry]
        core.x[place], core.p[place, place] = float(value), origin**2 + _OFF**2
    core.begin([step.windows for step in steps if not step.listen])
    used, place = 0, 0
    for step in steps:
        pose = core.step(step.windows, step.number, step.listen, LISTENED)
        for index in _until(t, place, pose.t):
            place = index + 1
            late = pose.t - float(t[index])
            back_x = float(x[index]) + pose.speed * late * np.cos(pose.heading)
            back_y = float(y[index]) + pose.speed * late * np.sin(pose.heading)
            off = _SPEED_SHARE * abs(pose.speed * late) + _OFF
            core.fix(Position(back_x, back_y, float(np.hypot(sigma[index], off))))
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
    vehicle: dict[str, dict[str, Quantity]] = {}
    unseen: list[str] = []
    for wheel in core.wheels:
        mine = nodes.setdefault(wheel.name, {})
        for entry in OF_WHEEL:
            _take(core, before, wheel, entry, mine, unseen)
    if len(core.wheels) == 2:
        _take(core, before, None, TRACK_WIDTH, vehicle, unseen)
    else:
        unseen.append("vehicle.track_width.error: one node does not show it; put nodes on both wheels")
    return WheelCalibration(nodes, vehicle, tuple(unseen), rms, fixes, warnings)


def _take(
    core: WheelStep,
    before: WheelStep,
    wheel: Wheel | None,
    entry: Entry,
    found: dict[str, dict[str, Quantity]],
    unseen: list[str],
) -> None:
    """An entry that a drive can show into `found`, or else a line into `unseen`."""
    name, facing = ("vehicle", None) if wheel is None else (wheel.name, wheel.node.facing)
    node = None if wheel is None else wheel.name
    quantity, prior = core.estimate(node, entry), before.estimate(node, entry)
    for parameter in entry.parameters:
        remedy = entry.remedy
        if not remedy:
            continue
        if quantity.sigma > _SEEN * prior.sigma:
            unseen.append(
                f"{name}.{entry.effect}.{parameter}: {quantity.sigma:.2g} after the drive, "
                f"{prior.sigma:.2g} before; {remedy}"
            )
            continue
        sign = 1.0 if facing is None else entry.sign(facing)
        sigma = math.hypot(quantity.sigma, _left_out(entry.effect, quantity.value))
        found.setdefault(entry.effect, {})[parameter] = Quantity(sign * quantity.value, sigma)


def _left_out(effect: str, value: float) -> float:
    floors = {"node_misalignment": _TILT_SHARE * abs(value) + 1e-4, "gyro_bias": _BIAS_FLOOR}
    return floors.get(effect, _SCALE_FLOOR if effect == "gyro_scale_factor" else 0.0)


def _effects(
    found: Mapping[str, Mapping[str, Quantity]], provenance: Mapping[str, object]
) -> dict[str, CalibratedEffect]:
    return {name: CalibratedEffect(parameters, **provenance) for name, parameters in found.items()}  # type: ignore[arg-type]
