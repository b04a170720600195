"""Page sections of an IMU calibration: parameters, residuals and standstills."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hubodo.pages.curves import Curve, Values, draw_curves
from hubodo.pages.page import COLOURS, PageTable, Section
from hubodo.sensors.imu.held_out import CrossValidation

if TYPE_CHECKING:
    from hubodo.sensors.imu.result import ImuCalibration

PARAMETER_HEADINGS = ("effect", "parameter", "value", "1σ")


def imu_sections(result: ImuCalibration) -> Sequence[Section]:
    """Return the page sections of a calibration."""
    return (_parameters(result), _residuals(result), _standstills(result))


def format_held_out(held_out: CrossValidation | None, unit: str, factor: float = 1.0) -> str:
    """Return the held-out errors before and after calibration as one phrase."""
    if held_out is None:
        return "no data were held out"
    return (
        f"{held_out.rms_before * factor:.4g} {unit} rms before, {held_out.rms * factor:.4g} {unit} after "
        f"(largest {np.abs(held_out.error).max() * factor:.4g}), on {len(held_out.error)} held out of the fit"
    )


def parameter_rows(result: ImuCalibration) -> list[tuple[str, ...]]:
    """Return effect, parameter, value and sigma of each parameter."""
    return [
        (effect, name, f"{q.value:+.6g}", f"{q.sigma:.2g}")
        for effect, parameters in result.effect_parameters().items()
        for name, q in parameters.items()
    ]


def _parameters(result: ImuCalibration) -> Section:
    poses = result.accel.poses
    text = (
        f"true = (I + diag(e) + N)^-1 (raw - b), SI units. The {poses.count} poses have condition number "
        f"{poses.condition:.3g}. " + " ".join(f"{note[0].upper()}{note[1:]}." for note in result.notes)
    )
    return Section("Calibration of the IMU", text, [PageTable(PARAMETER_HEADINGS, parameter_rows(result))])


def _residuals(result: ImuCalibration) -> Section:
    count = np.arange(1, len(result.standstills) + 1)
    lengths = _before_and_after(count, result.accel.residual_before, result.accel.residual)
    figures = [draw_curves(lengths, "standstill", "norm minus gravity, m/s²")]
    text = f"Norm of the accelerometer: {format_held_out(result.accel_held_out, 'm/s²')}."
    turns = result.gyro.turns
    if turns is not None:
        angles = _before_and_after(turns.used + 1, np.degrees(turns.error_before), np.degrees(turns.error))
        figures.append(draw_curves(angles, "turn", "angle error against gravity, °"))
        text += f" Gyro turns: {format_held_out(result.gyro.held_out, 'degrees', 180 / np.pi)}."
    return Section("Before and after", text, figures=figures)


def _before_and_after(x: Values, before: Values, after: Values) -> list[Curve]:
    return [
        Curve(x, before, "before", COLOURS["right"], dots=True),
        Curve(x, after, "after", COLOURS["left"], dots=True),
    ]


def _standstills(result: ImuCalibration) -> Section:
    standstills = result.standstills
    rows = [
        [
            str(k + 1),
            f"{standstills.t[k, 0]:.2f}",
            f"{standstills.duration[k]:.1f}",
            *(f"{a:+.3f}" for a in standstills.accel[k]),
            f"{result.accel.residual_before[k]:+.4f}",
            f"{result.accel.residual[k]:+.5f}",
        ]
        for k in range(len(standstills))
    ]
    headings = [
        "standstill", "from, s", "duration, s", "ax", "ay", "az", "norm error before, m/s²", "after, m/s²",
    ]  # fmt: skip
    return Section(f"{len(standstills)} standstills", tables=[PageTable(headings, rows)])
