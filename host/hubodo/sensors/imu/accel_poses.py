"""Calibration of the accelerometers by the length of gravity in static poses, without contradictory ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.errors import CalibrationError
from hubodo.sensors.imu.accel_temperature import fit_accel_temperature
from hubodo.sensors.imu.held_out import CrossValidation, cross_validate_accel
from hubodo.sensors.imu.nonlinear_terms import describe_accelerometers, fit_accelerometers
from hubodo.sensors.imu.outlier_poses import drop_outlier_poses
from hubodo.sensors.imu.pose_temperature import PoseTemperature
from hubodo.sensors.imu.scalar_calibration import Convention, ScalarCalibration
from hubodo.sensors.imu.standstills import Standstills
from hubodo.sensors.imu.temperature_result import TemperatureTerms, accel_terms


@dataclass(frozen=True)
class CalibratedPoses:
    """The calibration of the accelerometers by static poses.

    Attributes:
        standstills: poses used, as they would be at 25 °C.
        accel: calibration of the triad.
        held_out: its errors on poses that were not fitted.
        notes: remarks.
        temperature: terms of the temperature, if it changes.
    """

    standstills: Standstills
    accel: ScalarCalibration
    held_out: CrossValidation | None
    notes: list[str]
    temperature: TemperatureTerms | None = None


def calibrate_accelerometers(
    standstills: Standstills,
    gravity: float,
    convention: Convention,
    temperatures: PoseTemperature | None = None,
    temperature_order: int | None = None,
) -> CalibratedPoses:
    """Calibrate the accelerometer triad by the length of gravity, m/s², without contradictory standstills.

    temperatures: of the standstills, if they change. Raises CalibrationError if the poses do not suffice, or
    held-out poses become worse.
    """
    model = None
    if temperatures is not None:
        model = fit_accel_temperature(standstills, temperatures, gravity, temperature_order)
    if temperatures is not None and model is not None:
        at_reference = model.remove(standstills.accel, temperatures.poses)
        standstills = replace(standstills, accel=at_reference)
    count, starts = len(standstills), standstills.start
    standstills = drop_outlier_poses(standstills, gravity)
    if temperatures is not None and len(standstills) < count:
        temperatures = temperatures.select(np.isin(starts, standstills.start))
    pose_terms = () if temperatures is None or model is None else model.terms(temperatures)
    calibration = fit_accelerometers(standstills, gravity, convention, pose_terms)
    held_out = cross_validate_accel(standstills, gravity, convention, calibration.exponents)
    if held_out is not None and held_out.rms > held_out.rms_before:
        raise CalibrationError(
            "the calibration makes the length of gravity worse in static poses that were not fitted "
            f"({held_out.rms_before:.2g} m/s² before, {held_out.rms:.2g} after): the accelerometers are "
            "better than these poses show; stand still longer, in more poses"
        )
    notes = [
        f"accelerometer misalignments: {convention} convention, from the norm of gravity in "
        f"{len(standstills)} {'poses' if standstills.are_means else 'standstills'}",
        *standstills.rejected,
        *describe_accelerometers(calibration),
    ]
    if not calibration.poses.is_sufficient:
        notes.insert(1, f"left out: {calibration.poses.describe_deficit('accel')}")
    terms = None if temperatures is None else accel_terms(temperatures, model, calibration)
    return CalibratedPoses(standstills, calibration, held_out, notes, terms)
