"""What is known of a gyro axis before its heading is taken: which way is up, its warm-up, its noise."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import CalibratedEffect
from hubodo.calibration.triad import triad_from_effects
from hubodo.effects.warmup import WarmupModel
from hubodo.errors import InputError
from hubodo.fuse.heading_filter import BiasNoise

_MAX_LEAN, _WARN_LEAN = math.radians(30.0), math.radians(3.0)


def upright(accel: Array, axis: str) -> tuple[float, str]:
    """+1 where the axis points up and -1 where it points down, and a note for people, "" without.

    accel: (N, 3) m/s². Raises InputError where the axis leans by more than 30 degrees.
    """
    force = accel.mean(axis=0)
    size = float(np.linalg.norm(force))
    along = float(force["xyz".index(axis)])
    if size < 1.0:
        return 1.0, f"no gravity in the accelerometer: {axis} is taken to point upwards"
    lean = math.acos(min(1.0, abs(along) / size))
    if lean > _MAX_LEAN:
        raise InputError(
            f"axis {axis} stands {math.degrees(lean):.0f} degrees off the vertical and feels little of a "
            "turn; choose the one that stands upright with --axis"
        )
    note = (
        f"axis {axis} leans by {math.degrees(lean):.1f} degrees (or the accelerometer is not calibrated): "
        f"turns read {100 * (1 - math.cos(lean)):.2g} % low"
    )
    return math.copysign(1.0, along), note if lean > _WARN_LEAN else ""


def warmup_upwards(
    effects: Mapping[str, CalibratedEffect], axis: str, up: float, *, thermometer: bool
) -> tuple[WarmupModel, dict[str, float]]:
    """The warm-up of the axis once scale and cross-axis are taken out, and 1 sigma of its parameters.

    effects: of the node. up: +1 or -1. thermometer: the log has a temperature. Raises InputError where the
    calibration needs one and the log has none.
    """
    matrix = triad_from_effects(effects, "gyro").matrix

    def upwards(effect: CalibratedEffect, which: str = "") -> float:
        raw = np.array([effect.value(name + which) for name in "xyz"])
        return up * float(np.linalg.solve(matrix, raw)["xyz".index(axis)])

    model = WarmupModel(0.0)
    sigmas: dict[str, float] = {}
    warm = effects.get("gyro_warmup")
    for which in ("", "_second"):
        if warm is not None and axis + which in warm.parameters:
            constant = warm.parameters[f"time_constant{which}"]
            size = {f"c1{which}": upwards(warm, which), f"time_constant{which}": constant.value}
            model = replace(model, **size)
            sigmas |= {
                f"c1{which}": warm.parameters[axis + which].sigma,
                f"time_constant{which}": constant.sigma,
            }
    by_heat = effects.get("gyro_temperature")
    if by_heat is not None and axis in by_heat.parameters:
        if not thermometer:
            raise InputError("the calibration's bias follows the temperature, which this log does not have")
        model = replace(model, temperature_coefficient=upwards(by_heat))
        sigmas["temperature_coefficient"] = by_heat.parameters[axis].sigma
    return model, sigmas


def noise_of_allan(path: Path) -> BiasNoise:
    """N, B and K as `hubodo allan --json` printed them. Raises InputError for another file, or without N."""
    try:
        told = json.loads(path.read_text("utf-8"))["coefficients"]
        n, b, k = (float(told[name]["value"] or 0.0) for name in "NBK")
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} is not what hubodo allan --json prints ({type(error).__name__}: {error})"
        ) from None
    if n <= 0.0:
        raise InputError(f"{path} shows no angle random walk (N); record the axis faster or finer")
    return BiasNoise(n, b, k)
