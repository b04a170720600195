"""Page sections of an IMU calibration: parameters, residuals and standstills."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hubodo.calibration.parameter_table import PARAMETER_HEADINGS, SIGNIFICANT_SIGMA
from hubodo.calibration.parameter_table import parameter_rows as table_rows
from hubodo.pages.curves import Curve, draw_curves
from hubodo.pages.page import COLOURS, PageTable, Section
from hubodo.sensors.imu.held_out import CrossValidation

if TYPE_CHECKING:
    from hubodo.sensors.imu.result import ImuCalibration

__all__ = ["PARAMETER_HEADINGS", "format_held_out", "imu_sections", "parameter_rows"]


def imu_sections(result: ImuCalibration) -> Sequence[Section]:
    """Return the page sections of a calibration."""
    return (*_residuals(result), _parameters(result), *_standstills(result))


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
    return f"{verdict} Length of gravity: {format_held_out(held_out, 'm/s²')}."


def format_held_out(held_out: CrossValidation | None, unit: str, factor: float = 1.0) -> str:
    """Return the held-out errors before and after calibration as one phrase."""
    if held_out is None:
        return "no data were held out"
    return (
        f"{held_out.rms_before * factor:.2g} {unit} rms before, {held_out.rms * factor:.2g} {unit} after "
        f"(largest {np.abs(held_out.error).max() * factor:.2g}), on {len(held_out.error)} held out of the fit"
    )


def parameter_rows(result: ImuCalibration) -> list[tuple[str, ...]]:
    """Return a row of PARAMETER_HEADINGS for each parameter."""
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
    return Section("Parameters", text, [PageTable(PARAMETER_HEADINGS, parameter_rows(result))])


def _residuals(result: ImuCalibration) -> Sequence[Section]:
    if result.accel is None:
        return ()
    figures = []
    if result.accel_held_out is not None:
        lengths = _before_and_after(result.accel_held_out)
        figures.append(draw_curves(lengths, "standstill", "norm minus gravity, m/s²"))
    text = f"Norm of the accelerometer: {format_held_out(result.accel_held_out, 'm/s²')}."
    if result.gyro is not None and result.gyro.turns is not None:
        if result.gyro.held_out is not None:
            angles = _before_and_after(result.gyro.held_out, 180 / np.pi)
            figures.append(draw_curves(angles, "turn", "angle error against gravity, °"))
        text += f" Gyro turns: {format_held_out(result.gyro.held_out, 'degrees', 180 / np.pi)}."
    return (Section("Before and after", text, figures=figures),)


def _before_and_after(held_out: CrossValidation, factor: float = 1.0) -> list[Curve]:
    """Return the errors of what was held out of the fit, the same that the text summarises."""
    number = held_out.index + 1
    return [
        Curve(number, factor * held_out.error_before, "before", COLOURS["right"], dots=True),
        Curve(number, factor * held_out.error, "after, held out of the fit", COLOURS["left"], dots=True),
    ]


def _standstills(result: ImuCalibration) -> Sequence[Section]:
    standstills, accel = result.standstills, result.accel
    if standstills is None or accel is None:
        return ()
    rows = [
        [
            standstills.name(k),
            *(f"{a:+.3f}" for a in standstills.accel[k]),
            f"{accel.residual_before[k]:+.4f}",
            f"{accel.residual[k]:+.5f}",
        ]
        for k in range(len(standstills))
    ]
    headings = ["pose", "ax, m/s²", "ay, m/s²", "az, m/s²", "norm error before, m/s²", "after, m/s²"]
    return (Section(f"{len(standstills)} poses", tables=[PageTable(headings, rows)], is_folded=True),)
