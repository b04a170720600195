"""Page sections of an IMU calibration: parameters, residuals and standstills."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hubodo.calibration.parameter_table import SIGNIFICANT_SIGMA, parameter_headings
from hubodo.calibration.parameter_table import parameter_rows as table_rows
from hubodo.pages.curves import Curve, draw_curves
from hubodo.pages.page import COLOURS, PageTable, Section
from hubodo.sensors.imu.held_out import CrossValidation
from hubodo.unit_systems import ACCELERATION, ANGLE, GRAVITY, RATE, RATE_SAMPLE, ShownUnit

if TYPE_CHECKING:
    from hubodo.sensors.imu.result import ImuCalibration

__all__ = [
    "format_gravity_error",
    "format_turn_error",
    "imu_sections",
    "parameter_headings",
    "parameter_rows",
]


_CURVE_POINTS = 100


def imu_sections(result: ImuCalibration) -> Sequence[Section]:
    """Return the page sections of a calibration."""
    return (*_residuals(result), _parameters(result), *_temperature(result), *_standstills(result))


def imu_verdict(result: ImuCalibration) -> str:
    """Return how much the calibration improves the length of gravity in held-out poses."""
    held_out = result.accel_held_out
    if result.accel is None:
        return f"Calibrated. {result.notes[0][0].upper()}{result.notes[0][1:]}."
    if held_out is None:
        return "Too few poses for a held-out check: the gain is not verified."
    ratio = held_out.rms_before / held_out.rms if held_out.rms > 0.0 else np.inf
    verdict = (
        f"Calibrated: the error of gravity is {ratio:.3g} times smaller."
        if ratio > 1.0
        else "Not better than the raw samples: the sensor is as good as this check."
    )
    return f"{verdict} Length of gravity: {format_gravity_error(held_out)}."


def format_gravity_error(held_out: CrossValidation | None) -> str:
    """Return the held-out errors of the length of gravity as one phrase."""
    return _format_held_out(held_out, ACCELERATION.shown(si_by_default=True))


def format_turn_error(held_out: CrossValidation | None) -> str:
    """Return the held-out errors of turns as one phrase."""
    return _format_held_out(held_out, ANGLE.shown())


def _format_held_out(held_out: CrossValidation | None, unit: ShownUnit) -> str:
    """Return the held-out errors before and after calibration as one phrase."""
    if held_out is None:
        return "no data were held out"
    values = (held_out.rms_before, held_out.rms, float(np.abs(held_out.error).max()))
    before, after, largest = (value * unit.factor for value in values)
    name = unit.name if unit.name == "°" else f" {unit.name}"
    return (
        f"{before:.2g}{name} rms before, {after:.2g}{name} after "
        f"(largest {largest:.2g}), on {len(held_out.error)} held out of the fit"
    )


def parameter_rows(result: ImuCalibration) -> list[tuple[str, ...]]:
    """Return a row of `parameter_headings` for each parameter."""
    return list(table_rows(result.effect_parameters()))


def _parameters(result: ImuCalibration) -> Section:
    poses = ""
    if result.accel is not None:
        quality = result.accel.poses
        poses = f"The {quality.count} poses have condition number {quality.condition:.3g}. "
    text = (
        f"Significant are values beyond {SIGNIFICANT_SIGMA:.0f} of their own sigma. "
        f"true = (I + diag(e) + N)⁻¹ (raw − b), SI units. {poses}"
        + " ".join(f"{note[0].upper()}{note[1:]}." for note in result.notes)
    )
    return Section("Parameters", text, [PageTable(parameter_headings(), parameter_rows(result))])


def _residuals(result: ImuCalibration) -> Sequence[Section]:
    if result.accel is None:
        return ()
    figures, unit = [], ACCELERATION.shown(si_by_default=True)
    if result.accel_held_out is not None:
        lengths = _before_and_after(result.accel_held_out, unit.factor)
        figures.append(draw_curves(lengths, "standstill", f"norm minus gravity, {unit.name}"))
    text = f"Norm of the accelerometer: {format_gravity_error(result.accel_held_out)}."
    if result.gyro is not None and result.gyro.turns is not None:
        if result.gyro.held_out is not None:
            angle = ANGLE.shown()
            angles = _before_and_after(result.gyro.held_out, angle.factor)
            figures.append(draw_curves(angles, "turn", f"angle to gravity, {angle.name}"))
        text += f" Gyro turns: {format_turn_error(result.gyro.held_out)}."
    return (Section("Before and after", text, figures=figures),)


def _before_and_after(held_out: CrossValidation, factor: float) -> list[Curve]:
    """Return the errors of what was held out of the fit, the same that the text summarises."""
    number = held_out.index + 1
    return [
        Curve(number, factor * held_out.error_before, "before", COLOURS["right"], dots=True),
        Curve(number, factor * held_out.error, "after, held out of the fit", COLOURS["left"], dots=True),
    ]


def _temperature(result: ImuCalibration) -> Sequence[Section]:
    """Return the section with the rates of the static poses against their temperature."""
    gyro = None if result.temperature is None else result.temperature.gyro
    if gyro is None:
        return ()
    unit, colours = RATE.shown(RATE_SAMPLE), [COLOURS[name] for name in ("left", "right", "fused")]
    grid = np.linspace(float(gyro.temperature.min()), float(gyro.temperature.max()), _CURVE_POINTS)
    mean, change = gyro.rate.mean(axis=0), gyro.change(grid)
    curves = []
    for k, (axis, colour) in enumerate(zip(("gx", "gy", "gz"), colours, strict=True)):
        curves.append(Curve(gyro.temperature, gyro.rate[:, k] * unit.factor, axis, colour, dots=True))
        curves.append(Curve(grid, (mean[k] + change[:, k]) * unit.factor, f"{axis}, polynomial", colour))
    figure = draw_curves(curves, "temperature, °C", f"rate in static poses, {unit.name}")
    text = f"Polynomials of order {gyro.order}, chosen by poses that were not fitted."
    return (Section("Rate against temperature", text, figures=[figure]),)


def _standstills(result: ImuCalibration) -> Sequence[Section]:
    standstills, accel = result.standstills, result.accel
    if standstills is None or accel is None:
        return ()
    force, error = GRAVITY.shown(si_by_default=True), ACCELERATION.shown(si_by_default=True)
    rows = [
        [
            standstills.name(k),
            *(f"{a * force.factor:+.{3 if force.factor == 1.0 else 4}f}" for a in standstills.accel[k]),
            f"{accel.residual_before[k] * error.factor:+.4f}",
            f"{accel.residual[k] * error.factor:+.5f}",
        ]
        for k in range(len(standstills))
    ]
    axes = (f"{axis}, {force.name}" for axis in ("ax", "ay", "az"))
    headings = ["pose", *axes, f"norm error before, {error.name}", f"after, {error.name}"]
    return (Section(f"{len(standstills)} poses", tables=[PageTable(headings, rows)], is_folded=True),)
