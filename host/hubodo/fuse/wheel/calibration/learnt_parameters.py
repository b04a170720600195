"""Parameters learnt by a position-aided filter, with tests of observability and plausibility."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hubodo.calibration.file import CalibratedEffect, Quantity
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
from hubodo.fuse.wheel.wheel import Wheel

_MAX_SIGMA_SHARE = 0.5
"""Share of the prior sigma below which a parameter counts as determined."""

_MAX_PRIOR_SIGMAS = 4.0
"""Deviation from the prior, in sigmas, beyond which a value is refused: 1 in 16,000."""

_TILT_MODEL_SHARE, _ARM_MODEL_SHARE, _BIAS_MODEL_SIGMA, _SCALE_MODEL_SIGMA = 0.015, 0.02, 4e-4, 5e-4
"""Model errors of the filter, 1 sigma, from simulated drives.

Shares of a tilt and of an arm, which are observed through sensors with 1 % of scale error; rad/s of bias
change with temperature and gravity; a fraction for gyro scale, because both axes across share one number,
and for a radius, which changes with load and speed.
"""

_LIKELY_CAUSES = {
    WHEEL_RADIUS: "another wheel_radius in the vehicle file, positions in another unit, or wheels that slip",
    TRACK_WIDTH: "another track_width in the vehicle file, a wheel that steers, or sides that are exchanged",
    GYRO_SCALE_ACROSS: "positions in mirrored axes, a wheel that steers, or a side or facing that is wrong",
    GYRO_SCALE_Z: "a range of the gyro other than the log says, or time stamps in another unit",
}
"""Likely causes of an implausible value."""

_OTHER_CAUSES = "a side or facing that is wrong, a node that sits loose, or positions of another drive"


@dataclass
class LearntParameters:
    """Parameters learnt from a drive.

    Attributes
    ----------
    nodes : name -> effect -> parameter -> value and sigma, node axes.
    vehicle : effect -> parameter -> value and sigma.
    not_observable : one line each.
    antenna : x and y, m.
    """

    nodes: dict[str, dict[str, dict[str, Quantity]]] = field(default_factory=dict)
    vehicle: dict[str, dict[str, Quantity]] = field(default_factory=dict)
    not_observable: list[str] = field(default_factory=list)
    antenna: tuple[Quantity, Quantity] = (Quantity(0.0, 0.0), Quantity(0.0, 0.0))


def extract_parameters(
    core: FilterCore, before: FilterCore, turned: float, distance: float
) -> LearntParameters:
    """Return the parameters that `core` knows better than `before`, the same filter without a drive.

    turned: rad between the extremes of the heading; distance: m. Raise CalibrationError with the likely
    cause if a value deviates from its prior by four sigmas.
    """
    learnt = LearntParameters(antenna=(core.estimate(None, ANTENNA_X), core.estimate(None, ANTENNA_Y)))
    drive_extent = f"only {math.degrees(turned):.0f}° of turning, {distance:.0f} m"
    for wheel in core.wheels:
        effects = learnt.nodes.setdefault(wheel.name, {})
        for entry in WHEEL_ENTRIES:
            _extract_entry(core, before, wheel, entry, effects, learnt.not_observable, drive_extent)
    if len(core.wheels) == 2:
        _extract_entry(core, before, None, TRACK_WIDTH, learnt.vehicle, learnt.not_observable, drive_extent)
    else:
        learnt.not_observable.append(
            "vehicle.track_width.error: one node does not show it; put nodes on both wheels"
        )
    return learnt


def _extract_entry(
    core: FilterCore,
    before: FilterCore,
    wheel: Wheel | None,
    entry: Entry,
    effects: dict[str, dict[str, Quantity]],
    not_observable: list[str],
    drive_extent: str,
) -> None:
    """Add an entry to the effects if the drive determined it, else a line to `not_observable`."""
    if not entry.excitation:
        return
    name, facing = ("vehicle", None) if wheel is None else (wheel.name, wheel.node.facing)
    node = None if wheel is None else wheel.name
    quantity, prior = core.estimate(node, entry), before.estimate(node, entry)
    deviation = abs(quantity.value - prior.value)
    if deviation > _MAX_PRIOR_SIGMAS * prior.sigma:
        meaning = ""
        if entry is WHEEL_RADIUS and wheel is not None:
            meaning = f" (a radius of {wheel.geometry.radius * (1.0 + quantity.value):.4g} m)"
        raise CalibrationError(
            f"{name}.{entry} comes out as {quantity.value:+.3g}{meaning}, {deviation / prior.sigma:.1f} of "
            f"the {prior.sigma:.2g} it may be off: {_LIKELY_CAUSES.get(entry, _OTHER_CAUSES)}; nothing is "
            "written"
        )
    for parameter in entry.parameters:
        if quantity.sigma > _MAX_SIGMA_SHARE * prior.sigma:
            not_observable.append(
                f"{name}.{entry.effect}.{parameter}: {drive_extent}, ±{quantity.sigma:.2g} after it, "
                f"±{prior.sigma:.2g} before; {entry.excitation}"
            )
            continue
        sign = 1.0 if facing is None else entry.sign(facing)
        sigma = math.hypot(quantity.sigma, _model_sigma(entry.effect, quantity.value))
        effects.setdefault(entry.effect, {})[parameter] = Quantity(sign * quantity.value, sigma)


def _model_sigma(effect: str, value: float) -> float:
    floors = {
        "node_misalignment": _TILT_MODEL_SHARE * abs(value) + 1e-4,
        "gyro_bias": _BIAS_MODEL_SIGMA,
        "gyro_scale_factor": _SCALE_MODEL_SIGMA,
        "wheel_radius": _SCALE_MODEL_SIGMA,
        "lever_arm": _ARM_MODEL_SHARE * abs(value) + 1e-4,
    }
    return floors.get(effect, 0.0)


def quantities_as_json(
    effects: Mapping[str, Mapping[str, Quantity]],
) -> dict[str, dict[str, dict[str, float]]]:
    """Return the quantities as JSON."""
    return {
        effect: {name: {"value": q.value, "sigma": q.sigma} for name, q in parameters.items()}
        for effect, parameters in effects.items()
    }


def quantities_as_effects(
    quantities: Mapping[str, Mapping[str, Quantity]], **provenance: object
) -> dict[str, CalibratedEffect]:
    """Return the quantities as effects of a calibration file; provenance: other fields of each effect."""
    return {name: CalibratedEffect(parameters, **provenance) for name, parameters in quantities.items()}  # type: ignore[arg-type]
