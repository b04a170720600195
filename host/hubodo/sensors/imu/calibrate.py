"""Calibration of both triads of a node from standstills and turns, by the best available reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import fdtrc

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.earth import EARTH_RATE, STANDARD_GRAVITY
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu.accel_frame import accel_frame_covariance
from hubodo.sensors.imu.accel_poses import calibrate_accelerometers
from hubodo.sensors.imu.axis_signs import check_axis_signs
from hubodo.sensors.imu.earth_in_turns import estimate_earth_in_turns
from hubodo.sensors.imu.held_out import cross_validate_turns
from hubodo.sensors.imu.latitude_check import check_horizontal_rate
from hubodo.sensors.imu.nonlinear_gyros import calibrate_with_terms
from hubodo.sensors.imu.pose_temperature import measure_pose_temperature
from hubodo.sensors.imu.result import ImuCalibration, TriadCalibration
from hubodo.sensors.imu.scalar_calibration import Convention, ScalarCalibration
from hubodo.sensors.imu.standstills import Standstills, find_standstills
from hubodo.sensors.imu.temperature_result import TemperatureTerms
from hubodo.sensors.imu.temperature_stages import state_at_reference, subtract_gyro_polynomial
from hubodo.sensors.imu.turns import Turns, collect_turns
from hubodo.sensors.imu.uneven_codes import uneven_code_sigma, widen_accelerometers
from hubodo.sensors.imu.vector_references import (
    calibrate_by_earth_rate,
    calibrate_by_table,
    calibrate_gyro_alone,
    earth_rate_deficit,
)

MAX_G_SENSITIVITY_P_VALUE = 1e-3
MIN_CORRELATED_COUNT = 8
"""Standstills from which on the correlation of neighbours is estimated."""
MAX_CORRELATION = 0.9
"""Largest correlation of neighbouring standstills that is considered: that of a steady drift."""


def calibrate_imu(
    t: Array,
    gyro: Array,
    accel: Array,
    *,
    gravity: float = 9.80665,
    latitude: float | None = None,
    table_rate: float | None = None,
    convention: Convention = "symmetric",
    min_standstill: float = 1.0,
    temperature: Array | None = None,
    temperature_order: int | None = None,
) -> ImuCalibration:
    """Calibrate both triads of a node from a record with standstills in nine or more poses.

    t: (N,) s. gyro: (N, 3) rad/s. accel: (N, 3) m/s². A triad that is not measured has the shape (N, 0).
    gravity: local gravity, m/s². latitude: rad, needed for Earth rate as the reference of the gyros; without
    it, or if the gyros are too noisy, the turns between standstills are the reference. table_rate: rate of a
    rate table, rad/s, on which the node turned steadily in nine or more poses; it is then the reference. The
    reference of a gyro alone is Earth rate or that of the table. convention: convention of the
    accelerometer misalignments. min_standstill: s. temperature: (N,) °C, NaN where unknown; biases and scales
    are then stated at 25 °C, with the terms of the temperature that the record shows. temperature_order:
    stated order of the polynomials of the biases; None selects it. Raises CalibrationError if data are
    missing, InputError for an impossible gravity or latitude.
    """
    check_place(gravity, latitude)
    _check_finite(t, gyro, accel)
    if not accel.shape[1]:
        rests, alone = calibrate_gyro_alone(t, gyro, table_rate, min_standstill)
        notes = [f"gyros: {alone.method}", "gyro misalignments by the symmetric convention: no accelerometer"]
        return ImuCalibration(rests, gravity, None, None, alone, tuple(notes))
    standstills = find_standstills(t, gyro, accel, min_duration=min_standstill)
    temperatures = measure_pose_temperature(t, temperature, standstills, is_required=bool(temperature_order))
    poses = calibrate_accelerometers(
        widen_accelerometers(accel, standstills), gravity, convention, temperatures, temperature_order
    )
    standstills, accelerometers, notes, terms = poses.standstills, poses.accel, poses.notes, poses.temperature
    result = ImuCalibration(standstills, gravity, accelerometers, poses.held_out, None, ())
    if terms is not None and terms.accel is not None:
        accel = terms.accel.remove(accel, terms.temperatures.samples)
    if gyro.shape[1]:
        # Rounded codes are recognised in the samples as they were measured.
        uneven = uneven_code_sigma(gyro, standstills, notes)
        if terms is not None:
            gyro, standstills, terms = subtract_gyro_polynomial(gyro, standstills, terms, temperature_order)
        force = accelerometers.correct(standstills.accel)
        check_axis_signs(collect_turns(t, gyro, standstills.gyro.mean(axis=0), standstills, force))
        if table_rate is None:
            all_force = np.asarray(accelerometers.correct(accel))
            calibrated = _calibrate_gyro(
                t, gyro, all_force, standstills, accelerometers, latitude, notes, uneven, terms
            )
        else:
            calibrated = calibrate_by_table(t, gyro, standstills, force, table_rate, notes)
        if terms is not None:
            calibrated, terms = state_at_reference(calibrated, terms)
        notes.insert(1, f"gyros: {calibrated.method}")
        result = replace(result, gyro=calibrated)
    notes.extend([] if terms is None else terms.notes())
    return replace(result, notes=tuple(notes), temperature=terms)


def check_place(gravity: float, latitude: float | None) -> None:
    """Raise InputError for a gravity (m/s²) or latitude (rad) that no place on Earth has."""
    if not 9.7 < gravity < 9.9:
        raise InputError(
            f"gravity {gravity} m/s² does not occur on Earth's surface (9.76 to 9.84); give the local value"
        )
    if latitude is not None and abs(latitude) > np.pi / 2:
        degrees = "; it is given in degrees, radians are expected" if abs(latitude) <= 90 else ""
        raise InputError(f"latitude {np.degrees(latitude):.4g} degrees is out of range{degrees}")


def _check_finite(t: Array, gyro: Array, accel: Array) -> None:
    """Raise InputError with the first time at which a sample is not a number."""
    for name, values in (("gyro", gyro), ("accelerometer", accel)):
        if not values.shape[1]:
            continue
        missing = ~np.isfinite(values).all(axis=1)
        if missing.all():
            raise InputError(f"the {name} is not measured: every sample lacks an axis")
        if missing.any():
            raise InputError(
                f"the {name} has {np.count_nonzero(missing)} samples that are not numbers, the first at "
                f"{t[int(np.argmax(missing))]:.6g} s; remove them (hubodo import --repair)"
            )


def estimate_static_bias(
    rate: Array, rate_sigma: Array, force: Array
) -> tuple[Array, Array, Array | None, Array | None]:
    """Estimate the gyro bias from standstills, with g-sensitivity if a joint F-test is significant.

    rate, rate_sigma: (R, 3) rad/s. force: (R, 3) m/s². Returns the bias (3,), its covariance (3, 3), and
    g-sensitivity and its sigma, (3, 3) each, or None.
    """
    count = len(rate)
    mean = rate.mean(axis=0)
    total_squares = ((rate - mean) ** 2).sum(axis=0)
    floor = (rate_sigma**2).mean(axis=0) / count
    if count < 3:
        return mean, np.diag(floor), None, None
    scatter = total_squares / (count - 1) / count
    if count >= MIN_CORRELATED_COUNT:
        scatter = scatter * _correlation_factor(rate - mean)
    mean_covariance = np.diag(np.maximum(scatter, floor))
    columns = np.column_stack([np.ones(count), force])
    if count < 8 or np.linalg.cond(columns / np.linalg.norm(columns, axis=0)) > 30:
        return mean, mean_covariance, None, None
    coefficients = np.linalg.lstsq(columns, rate, rcond=None)[0]
    residual_squares = ((rate - columns @ coefficients) ** 2).sum(axis=0)
    dof = count - 4
    ratio = float(
        ((total_squares - residual_squares).sum() / 9) / max(residual_squares.sum() / (3 * dof), 1e-300)
    )
    if fdtrc(9, 3 * dof, max(ratio, 0.0)) > MAX_G_SENSITIVITY_P_VALUE:
        return mean, mean_covariance, None, None
    inverse_normal = np.linalg.inv(columns.T @ columns)
    variance = np.maximum(residual_squares / dof, (rate_sigma**2).mean(axis=0))
    coefficient_sigma = np.sqrt(np.outer(variance, np.diag(inverse_normal)[1:]))
    return (
        coefficients[0],
        np.diag(variance * inverse_normal[0, 0]),
        np.asarray(coefficients[1:].T),
        np.asarray(coefficient_sigma),
    )


def _correlation_factor(residual: Array) -> Array:
    """Return the (C,) factors by which correlated residuals (R, C) in order of time widen the variance.

    Of a first-order Gauss-Markov sequence with correlation r between neighbours the mean has the variance
    (1 + r) / (1 - r) times that of white noise.
    """
    correlation = (residual[1:] * residual[:-1]).sum(axis=0) / np.maximum((residual**2).sum(axis=0), 1e-300)
    correlation = np.clip(correlation, 0.0, MAX_CORRELATION)
    return np.asarray((1.0 + correlation) / (1.0 - correlation))


def try_earth_rate(
    standstills: Standstills, force: Array, latitude: float | None, notes: list[str]
) -> TriadCalibration | None:
    """Return the calibration by Earth rate; None without a latitude or, with a note, if that fails."""
    if latitude is None:
        return None
    if deficit := earth_rate_deficit(standstills):
        notes.append(deficit)
        return None
    try:
        return calibrate_by_earth_rate(standstills, force, latitude, notes)
    except CalibrationError as error:
        notes.append(f"Earth rate cannot be used as the gyros' reference: {error}")
        return None


def _calibrate_gyro(
    t: Array,
    gyro: Array,
    all_force: Array,
    standstills: Standstills,
    accel: ScalarCalibration,
    latitude: float | None,
    notes: list[str],
    uneven_sigma: Array,
    terms: TemperatureTerms | None = None,
) -> TriadCalibration:
    force = accel.correct(standstills.accel)
    static_bias = estimate_static_bias(standstills.gyro, standstills.gyro_sigma, force)
    bias, bias_covariance, g_sensitivity, g_sigma = static_bias
    uneven = np.diag(uneven_sigma**2)
    if (by_earth_rate := try_earth_rate(standstills, force, latitude, notes)) is not None:
        return replace(by_earth_rate, covariance=by_earth_rate.covariance + np.pad(uneven, (0, 9)))
    # A turn passes many codes, so this sigma is part of the prior with which the turns estimate the bias.
    bias_covariance = bias_covariance + uneven
    total_bias = np.asarray(bias if g_sensitivity is None else bias + all_force @ g_sensitivity.T)
    turns = _add_temperature(collect_turns(t, gyro, total_bias, standstills, force), standstills, terms)
    # The direction of Earth rate in each standstill is unknown, so it adds to the uncertainty of the bias.
    unknown_earth = np.eye(3) * EARTH_RATE**2 / 3 / len(standstills)
    try:
        earth = estimate_earth_in_turns(turns, np.sqrt(np.diag(bias_covariance + unknown_earth)), latitude)
    except CalibrationError:
        bias_covariance = bias_covariance + unknown_earth
    else:
        if latitude is not None:
            check_horizontal_rate(*earth.horizontal, latitude)
        bias, bias_covariance, g_sensitivity, g_sigma = estimate_static_bias(
            standstills.gyro - earth.rates, standstills.gyro_sigma, force
        )
        design = np.ones((len(force), 1))
        if g_sensitivity is not None:
            design = np.column_stack([design, force])
        noise_variance = (standstills.gyro_sigma**2).mean(axis=0)
        bias_covariance = uneven + earth.bias_covariance(bias_covariance, design, noise_variance)
        if g_sigma is not None and latitude is None:
            # The vertical Earth rate is proportional to gravity, like an equal g-sensitivity of all axes.
            g_sigma = np.hypot(g_sigma, np.eye(3) * EARTH_RATE / np.sqrt(3) / STANDARD_GRAVITY)
        total_bias = np.asarray(bias if g_sensitivity is None else bias + all_force @ g_sensitivity.T)
        turns = replace(
            _add_temperature(collect_turns(t, gyro, total_bias, standstills, force), standstills, terms),
            earth_slopes=earth.turns.earth_slopes,
            earth_sigma=earth.turns.earth_sigma,
        )
    static = TriadCalibration(
        Triad(bias),
        np.pad(bias_covariance, (0, 9)),
        np.zeros(9, bool),
        f"bias alone, from {len(standstills)} standstills",
        g_sensitivity,
        g_sigma,
    )
    calibrated = _add_turns(static, turns, standstills, accel, notes)
    if uneven.any() and calibrated.turns is not None:
        # Near their ends the turns use the same codes as the standstills.
        calibrated = replace(calibrated, covariance=calibrated.covariance + np.pad(uneven, (0, 9)))
    return calibrated


def _add_temperature(turns: Turns, standstills: Standstills, terms: TemperatureTerms | None) -> Turns:
    """Return the turns with their temperatures, if it changes."""
    if terms is None:
        return turns
    samples = terms.temperatures.samples
    starts, ends = standstills.end[:-1] - 1, standstills.start[1:] + 1
    means = np.array([samples[i:j].mean() for i, j in zip(starts, ends, strict=True)])
    return replace(turns, temperature=means[turns.number])


def _add_turns(
    static: TriadCalibration,
    turns: Turns,
    standstills: Standstills,
    accel: ScalarCalibration,
    notes: list[str],
) -> TriadCalibration:
    """Return the calibration refined by the turns between standstills, or unchanged if that fails."""
    bias_sigma = np.sqrt(np.diag(static.covariance)[:3])
    try:
        turns, calibration, nonlinear = calibrate_with_terms(turns, bias_sigma)
    except CalibrationError as error:
        notes.append(f"gyro scale and misalignments left out: {error}")
        return static
    notes.extend((*nonlinear, *calibration.dropped))
    if calibration.deficit:
        notes.append(f"left out: {calibration.deficit}")
    notes.append(
        "the scale of the gyros is relative to the clock of the log: times that run 1 % fast make it 1 % too "
        "high"
    )
    determined = (
        "scale and all six misalignments"
        if calibration.is_observable.all()
        else "what they show of scale and misalignments"
    )
    method = (
        f"turns between standstills, {len(calibration.used)} of them, gyro against accelerometer: "
        f"{determined} in "
        f"the accelerometer's frame; bias{'' if static.g_sensitivity is None else ' and g-sensitivity'} from "
        f"{len(standstills)} standstills"
    )
    return replace(
        static,
        triad=Triad(static.triad.bias + calibration.bias_change, calibration.matrix),
        covariance=calibration.covariance + accel_frame_covariance(calibration, turns, standstills, accel),
        is_observable=calibration.is_observable,
        method=method,
        turns=calibration,
        held_out=cross_validate_turns(turns.select(calibration.used), bias_sigma),
    )
