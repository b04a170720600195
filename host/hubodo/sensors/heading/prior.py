"""Prior knowledge of a gyro axis for its heading: orientation, warm-up and noise."""

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
from hubodo.effects.temperature import POLYNOMIAL_SUFFIXES
from hubodo.effects.warmup import TEMPERATURE_PARAMETERS, WarmupModel
from hubodo.errors import InputError
from hubodo.fuse.heading_filter import BiasNoise

_MIN_GRAVITY = 5.0  # m/s², median of the magnitude
_MAX_TILT, _WARN_TILT = math.radians(30.0), math.radians(3.0)


def axis_direction(accel: Array, axis: str) -> tuple[float, str]:
    """Return +1 if the axis points up or -1 if it points down, and a remark for the user or "".

    accel: (N, 3) m/s². axis: "x", "y" or "z". Raises InputError if the axis is tilted by more than 30
    degrees, or rotates about a horizontal line.
    """
    if not np.isfinite(accel).all():
        return 1.0, f"without accelerometer {axis} is assumed to point upwards"
    force = accel.mean(axis=0)
    parameters = float(np.linalg.norm(force))
    axis_force = float(force["xyz".index(axis)])
    if parameters < 1.0:
        if np.median(np.linalg.norm(accel, axis=1)) > _MIN_GRAVITY:
            raise InputError(
                "gravity rotates in its axes, as on a wheel: its angle is not the heading of the vehicle; "
                "choose a node on the body with --node, or use hubodo fuse"
            )
        return 1.0, f"the accelerometer shows no gravity: {axis} is assumed to point upwards"
    tilt = math.acos(min(1.0, abs(axis_force) / parameters))
    if tilt > _MAX_TILT:
        raise InputError(
            f"axis {axis} is tilted by {math.degrees(tilt):.0f} degrees from the vertical and measures "
            "little of a turn; choose the vertical one with --axis"
        )
    note = (
        f"axis {axis} is tilted by {math.degrees(tilt):.1f} degrees (or the accelerometer is not "
        f"calibrated): measured turns are {100 * (1 - math.cos(tilt)):.2g} % too small"
    )
    return math.copysign(1.0, axis_force), note if tilt > _WARN_TILT else ""


def vertical_axis_warmup(
    effects: Mapping[str, CalibratedEffect], axis: str, up: float, *, thermometer: bool
) -> tuple[WarmupModel, dict[str, float]]:
    """Return the warm-up of the axis after correction of scale and cross-axis, and its parameter sigmas.

    effects: calibrated effects of the node. up: +1 or -1, as of `axis_direction`. thermometer: True if the
    log has a temperature. Raises InputError if the calibration needs a temperature and the log has none.
    """
    matrix = triad_from_effects(effects, "gyro").matrix

    def value_upwards(effect: CalibratedEffect, suffix: str = "") -> float:
        raw = np.array([effect.value(name + suffix) for name in "xyz"])
        return up * float(np.linalg.solve(matrix, raw)["xyz".index(axis)])

    model = WarmupModel(0.0)
    sigmas: dict[str, float] = {}
    warmup_effect = effects.get("gyro_warmup")
    for suffix in ("", "_second"):
        if warmup_effect is not None and axis + suffix in warmup_effect.parameters:
            time_constant = warmup_effect.parameters[f"time_constant{suffix}"]
            parameters = {
                f"c1{suffix}": value_upwards(warmup_effect, suffix),
                f"time_constant{suffix}": time_constant.value,
            }
            model = replace(model, **parameters)
            sigmas |= {
                f"c1{suffix}": warmup_effect.parameters[axis + suffix].sigma,
                f"time_constant{suffix}": time_constant.sigma,
            }
    temperature_effect = effects.get("gyro_temperature")
    if temperature_effect is not None and axis in temperature_effect.parameters:
        if not thermometer:
            raise InputError("the calibrated bias depends on temperature, which this log does not have")
        pairs = zip(POLYNOMIAL_SUFFIXES, TEMPERATURE_PARAMETERS, strict=True)
        polynomial = {name: value_upwards(temperature_effect, suffix) for suffix, name in pairs}
        model = replace(model, **polynomial)
        sigmas["temperature_coefficient"] = temperature_effect.parameters[axis].sigma
    return model, sigmas


def read_bias_noise(path: Path) -> BiasNoise:
    """Read N, B and K from the output of `hubodo allan --json`; raise InputError if the file lacks them."""
    try:
        coefficients = json.loads(path.read_text("utf-8"))["coefficients"]
        n, b, k = (float(coefficients[name]["value"] or 0.0) for name in "NBK")
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} is not an output of hubodo allan --json ({type(error).__name__}: {error})"
        ) from None
    if n <= 0.0:
        raise InputError(f"{path} has no angle random walk (N); record at a higher rate or resolution")
    return BiasNoise(n, b, k)
