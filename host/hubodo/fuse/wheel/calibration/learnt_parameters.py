"""What a filter that was told positions has learnt: values, what the drive did not show, what cannot be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hubodo.calibration.file import Quantity
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.entries import (
    ANTENNA_X,
    ANTENNA_Y,
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_Z,
    TRACK_WIDTH,
    WHEEL_ENTRIES,
    WHEEL_RADIUS,
    Entry,
)
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.state import Wheel

_SEEN = 0.5
"""A parameter counts as seen where its sigma fell below this share of what was believed before."""

_IMPOSSIBLE = 4.0
"""Sigmas of what was believed before, beyond which a value is not believed: 1 in 16,000 honest ones."""

_TILT_SHARE, _ARM_SHARE, _BIAS_FLOOR, _SCALE_FLOOR = 0.015, 0.02, 4e-4, 5e-4
"""What the filter's model leaves out, 1 sigma, found on simulated drives.

Shares of a tilt and of an arm, which are seen through sensors whose scale is known to 1 %; rad/s by which a
bias moves with temperature and gravity between the seconds it was seen in; a fraction, because the scale of
the two axes across is one number; the same of a radius, which load and speed change.
"""

_REASONS = {
    WHEEL_RADIUS: "another wheel_radius in the vehicle file, positions in another unit, or wheels that slip",
    TRACK_WIDTH: "another track_width in the vehicle file, a wheel that steers, or sides that are exchanged",
    GYRO_SCALE_ACROSS: "positions in mirrored axes, a wheel that steers, or a side or facing that is wrong",
    GYRO_SCALE_Z: "a range of the gyro other than the log says, or time stamps in another unit",
}
"""Why a value may be far from all that is believable."""

_ELSE = "a side or facing that is wrong, a node that sits loose, or positions of another drive"


@dataclass
class LearntParameters:
    """What a drive told.

    nodes: name -> effect -> parameter -> value and sigma, node's own axes; vehicle: the same. unseen: one
    line each. antenna: x and y, m.
    """

    nodes: dict[str, dict[str, dict[str, Quantity]]] = field(default_factory=dict)
    vehicle: dict[str, dict[str, Quantity]] = field(default_factory=dict)
    not_observable: list[str] = field(default_factory=list)
    antenna: tuple[Quantity, Quantity] = (Quantity(0.0, 0.0), Quantity(0.0, 0.0))


def extract_parameters(
    core: FilterCore, before: FilterCore, turned: float, distance: float
) -> LearntParameters:
    """What `core` knows better than `before`, the same filter without a drive.

    turned: rad between the extremes of the heading; distance: m. Raises CalibrationError where a value is
    four sigmas from what was believed, with the likely reason.
    """
    made = LearntParameters(antenna=(core.estimate(None, ANTENNA_X), core.estimate(None, ANTENNA_Y)))
    facts = f"only {math.degrees(turned):.0f}° of turning, {distance:.0f} m"
    for wheel in core.wheels:
        mine = made.nodes.setdefault(wheel.name, {})
        for entry in WHEEL_ENTRIES:
            _take(core, before, wheel, entry, mine, made.not_observable, facts)
    if len(core.wheels) == 2:
        _take(core, before, None, TRACK_WIDTH, made.vehicle, made.not_observable, facts)
    else:
        made.not_observable.append(
            "vehicle.track_width.error: one node does not show it; put nodes on both wheels"
        )
    return made


def _take(
    core: FilterCore,
    before: FilterCore,
    wheel: Wheel | None,
    entry: Entry,
    found: dict[str, dict[str, Quantity]],
    unseen: list[str],
    facts: str,
) -> None:
    """An entry that a drive can show into `found`, or else a line into `unseen`."""
    if not entry.excitation:
        return
    name, facing = ("vehicle", None) if wheel is None else (wheel.name, wheel.node.facing)
    node = None if wheel is None else wheel.name
    quantity, prior = core.estimate(node, entry), before.estimate(node, entry)
    off = abs(quantity.value - prior.value)
    if off > _IMPOSSIBLE * prior.sigma:
        raise CalibrationError(
            f"{name}.{entry} comes out as {quantity.value:+.3g}, {off / prior.sigma:.1f} of the "
            f"{prior.sigma:.2g} it may be off: {_REASONS.get(entry, _ELSE)}; nothing is written"
        )
    for parameter in entry.parameters:
        if quantity.sigma > _SEEN * prior.sigma:
            unseen.append(
                f"{name}.{entry.effect}.{parameter}: {facts}, ±{quantity.sigma:.2g} after it, "
                f"±{prior.sigma:.2g} before; {entry.excitation}"
            )
            continue
        sign = 1.0 if facing is None else entry.sign(facing)
        sigma = math.hypot(quantity.sigma, _left_out(entry.effect, quantity.value))
        found.setdefault(entry.effect, {})[parameter] = Quantity(sign * quantity.value, sigma)


def _left_out(effect: str, value: float) -> float:
    floors = {
        "node_misalignment": _TILT_SHARE * abs(value) + 1e-4,
        "gyro_bias": _BIAS_FLOOR,
        "gyro_scale_factor": _SCALE_FLOOR,
        "wheel_radius": _SCALE_FLOOR,
        "lever_arm": _ARM_SHARE * abs(value) + 1e-4,
    }
    return floors.get(effect, 0.0)


def quantities_as_json(found: Mapping[str, Mapping[str, Quantity]]) -> dict[str, dict[str, dict[str, float]]]:
    """For JSON."""
    return {
        effect: {name: {"value": q.value, "sigma": q.sigma} for name, q in parameters.items()}
        for effect, parameters in found.items()
    }
