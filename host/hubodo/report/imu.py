"""An IMU calibration as sections of a report page: rests, parameters, residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.report.curves import Curve, Values, curves
from hubodo.report.page import COLOURS, Grid, Section
from hubodo.sensors.imu.calibrate import ImuCalibration
from hubodo.sensors.imu.held_out import CrossValidation


def imu_sections(result: ImuCalibration) -> Sequence[Section]:
    """Sections for `hubodo.report.page.page`."""
    return (_parameters(result), _residuals(result), _rests(result))


def held_out_words(held_out: CrossValidation | None, unit: str, factor: float = 1.0) -> str:
    """Before and after on what took no part in the fit, in one phrase."""
    if held_out is None:
        return "nothing was left over to judge by"
    return (
        f"{held_out.rms_before * factor:.4g} {unit} rms before, {held_out.rms * factor:.4g} {unit} after "
        f"(largest {np.abs(held_out.error).max() * factor:.4g}), on {len(held_out.error)} not used in the fit"
    )


def _parameters(result: ImuCalibration) -> Section:
    rows = [
        [effect, name, f"{q.value:+.6g}", f"{q.sigma:.2g}"]
        for effect, parameters in result.effect_parameters().items()
        for name, q in parameters.items()
    ]
    poses = result.accel.poses
    text = (
        "true = (I + diag(e) + N)^-1 (raw - b), SI units. "
        f"The {poses.count} poses have condition number {poses.condition:.3g}. "
        + " ".join(f"{note[0].upper()}{note[1:]}." for note in result.notes)
    )
    return Section("Calibration of the IMU", text, [Grid(["effect", "parameter", "value", "1 sigma"], rows)])


def _residuals(result: ImuCalibration) -> Section:
    count = np.arange(1, len(result.standstills) + 1)
    lengths = _before_and_after(count, result.accel.residual_before, result.accel.residual)
    figures = [curves(lengths, "rest", "length less gravity, m/s²")]
    text = f"Accelerometer length: {held_out_words(result.accel_held_out, 'm/s²')}."
    turns = result.gyro.turns
    if turns is not None:
        angles = _before_and_after(turns.used + 1, np.degrees(turns.error_before), np.degrees(turns.error))
        figures.append(curves(angles, "turn", "gyros against gravity, °"))
        text += f" Gyro turns: {held_out_words(result.gyro.held_out, 'degrees', 180 / np.pi)}."
    return Section("Before and after", text, figures=figures)


def _before_and_after(x: Values, before: Values, after: Values) -> list[Curve]:
    return [
        Curve(x, before, "before", COLOURS["right"], dots=True),
        Curve(x, after, "after", COLOURS["left"], dots=True),
    ]


def _rests(result: ImuCalibration) -> Section:
    rests = result.standstills
    rows = [
        [
            str(k + 1),
            f"{rests.t[k, 0]:.2f}",
            f"{rests.duration[k]:.1f}",
            *(f"{a:+.3f}" for a in rests.accel[k]),
            f"{result.accel.residual_before[k]:+.4f}",
            f"{result.accel.residual[k]:+.5f}",
        ]
        for k in range(len(rests))
    ]
    headings = ["rest", "from, s", "for, s", "ax", "ay", "az", "length off before", "after, m/s²"]
    return Section(f"{len(rests)} rests", tables=[Grid(headings, rows)])
