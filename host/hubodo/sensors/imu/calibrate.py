"""Both triads of one node from one record of rests and turns, by the reference that the record can bear."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.calibration.triad import Triad, effects_from_triad
from hubodo.earth import EARTH_RATE
from hubodo.effects.gyro import GyroGSensitivity
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu.frame import frame_covariance
from hubodo.sensors.imu.held_out import HeldOut, accel_held_out, turns_held_out
from hubodo.sensors.imu.rests import Rests, find_rests, find_steady_rates
from hubodo.sensors.imu.scalar_calibration import Convention, ScalarCalibration, scalar_calibration
from hubodo.sensors.imu.turns import TurnCalibration, calibrate_by_turns, collect_turns
from hubodo.sensors.misalignment import align_by_earth_rate, turned

EARTH_RATE_SNR = 10.0
"""A rest must know Earth rate this much better than its size.

Below it the directions in eq. 5 are mostly noise, and the bias of their squares, 1/SNR², exceeds one per
cent.
"""
G_SENSITIVITY_P = 1e-3


@dataclass(frozen=True)
class GyroCalibration:
    """Gyro triad, how it was found, and its answer to specific force.

    triad: bias rad/s at no specific force, M in the accelerometer's frame unless `method` says otherwise.
    covariance: (12, 12) of b and M row by row. seen: (9,) which elements of M were determined.
    g_sensitivity: (3, 3) (rad/s)/(m/s²), row = gyro, with its sigma; None where the rests do not show it.
    turns: check by turns, if any.
    """

    triad: Triad
    covariance: Array
    seen: NDArray[np.bool_]
    method: str
    g_sensitivity: Array | None = None
    g_sensitivity_sigma: Array | None = None
    turns: TurnCalibration | None = None
    held_out: HeldOut | None = None


@dataclass(frozen=True)
class ImuCalibration:
    """Result for one node.

    Rests, both triads, how good they are where they were not fitted, what was used.
    """

    rests: Rests
    gravity: float
    accel: ScalarCalibration
    accel_held_out: HeldOut | None
    gyro: GyroCalibration
    notes: tuple[str, ...]

    def effects(self) -> Mapping[str, Mapping[str, Quantity]]:
        """Effect name -> parameters, for the calibration and the model file."""
        found = effects_from_triad(self.accel.triad, self.accel.sigma, "accel", self.accel.seen)
        sigma = np.sqrt(np.diag(self.gyro.covariance))
        seen = np.append(np.ones(3, bool), self.gyro.seen)
        found.update(effects_from_triad(self.gyro.triad, sigma, "gyro", seen))
        g, s = self.gyro.g_sensitivity, self.gyro.g_sensitivity_sigma
        if g is not None and s is not None:
            names = GyroGSensitivity.rows
            found[GyroGSensitivity.name] = {
                names[i][j]: Quantity(float(g[i, j]), float(s[i, j])) for i in (2, 0, 1) for j in range(3)
            }
        return found


def calibrate_imu(
    t: Array,
    gyro: Array,
    accel: Array,
    *,
    gravity: float = 9.80665,
    latitude: float | None = None,
    table_rate: float | None = None,
    convention: Convention = "symmetric",
    min_rest: float = 1.0,
) -> ImuCalibration:
    """Calibrate both triads of a node from a record in which it rests in nine or more poses.

    t: (N,) s. gyro: (N, 3) rad/s. accel: (N, 3) m/s². gravity: m/s² at the place. latitude: rad, needed for
    Earth rate as the gyros' reference; without it, or when the gyros are too noisy, the turns between rests
    are used. table_rate: rad/s of a rate table on which the node turned steadily in nine or more poses; then
    this is it. Raises CalibrationError with what is missing; InputError for an impossible gravity or
    latitude.
    """
    if not 9.7 < gravity < 9.9:
        raise InputError(
            f"gravity {gravity} m/s² does not occur on Earth's surface (9.76 to 9.84); give the local value"
        )
    if latitude is not None and abs(latitude) > np.pi / 2:
        raise InputError(
            f"latitude {np.degrees(latitude):.4g} degrees is out of range; give -90 to 90 degrees"
        )
    rests = find_rests(t, gyro, accel, min_duration=min_rest)
    notes = list(rests.rejected)
    accelerometers = scalar_calibration(
        rests.accel, gravity, rests.accel_sigma, convention=convention, partial=True
    )
    held_out = accel_held_out(rests, gravity, convention)
    force = accelerometers.triad.apply(rests.accel)
    every = np.asarray(accelerometers.triad.apply(accel))
    if table_rate is None:
        calibrated = _gyro(t, gyro, every, rests, accelerometers, latitude, notes)
    else:
        calibrated = _by_table(t, gyro, rests, force, table_rate, notes)
    notes.insert(
        0,
        f"accelerometer misalignments: {convention} convention, from gravity's length in {len(rests)} rests",
    )
    notes.insert(1, f"gyros: {calibrated.method}")
    if not accelerometers.poses.sufficient:
        notes.insert(2, f"left out: {accelerometers.poses.complaint('accel')}")
    return ImuCalibration(rests, gravity, accelerometers, held_out, calibrated, tuple(notes))


def rest_bias(
    rate: Array, rate_sigma: Array, force: Array
) -> tuple[Array, Array, Array | None, Array | None]:
    """Gyro bias from rests, with its answer to specific force where an F-test demands it.

    The test is of each gyro together. rate, rate_sigma, force: (R, 3). Returns b, covariance of b (3, 3),
    g-sensitivity (3, 3) or None, its sigma.
    """
    count = len(rate)
    mean = rate.mean(axis=0)
    around = ((rate - mean) ** 2).sum(axis=0)
    floor = (rate_sigma**2).mean(axis=0) / count
    if count < 3:
        return mean, np.diag(floor), None, None
    plain = np.diag(np.maximum(around / (count - 1) / count, floor))
    columns = np.column_stack([np.ones(count), force])
    if count < 8 or np.linalg.cond(columns / np.linalg.norm(columns, axis=0)) > 30:
        return mean, plain, None, None
    solved = np.linalg.lstsq(columns, rate, rcond=None)[0]
    left = ((rate - columns @ solved) ** 2).sum(axis=0)
    freedom = count - 4
    ratio = float(((around - left).sum() / 9) / max(left.sum() / (3 * freedom), 1e-300))
    if fdtrc(9, 3 * freedom, max(ratio, 0.0)) > G_SENSITIVITY_P:
        return mean, plain, None, None
    shape = np.linalg.inv(columns.T @ columns)
    variance = np.maximum(left / freedom, (rate_sigma**2).mean(axis=0))
    spread = np.sqrt(np.outer(variance, np.diag(shape)[1:]))
    return solved[0], np.diag(variance * shape[0, 0]), np.asarray(solved[1:].T), np.asarray(spread)


def _gyro(
    t: Array,
    gyro: Array,
    every: Array,
    rests: Rests,
    accel: ScalarCalibration,
    latitude: float | None,
    notes: list[str],
) -> GyroCalibration:
    force = accel.triad.apply(rests.accel)
    bias, bias_covariance, g, g_sigma = rest_bias(rests.gyro, rests.gyro_sigma, force)
    noise = float(np.sqrt((rests.gyro_sigma**2).mean(axis=1)).max())
    if latitude is not None and noise * EARTH_RATE_SNR < EARTH_RATE:
        try:
            return _by_earth_rate(rests, force, latitude, notes)
        except CalibrationError as error:
            notes.append(f"Earth rate does not serve as the gyros' reference here: {error}")
    elif latitude is not None:
        needed = float(np.median(rests.duration)) * (noise * EARTH_RATE_SNR / EARTH_RATE) ** 2
        notes.append(
            f"gyros too noisy for Earth rate: a rest knows the rate to {noise:.2g} rad/s, Earth turns at "
            f"{EARTH_RATE:.2g}; rests of {needed:.0f} s would be needed, if the bias held still so long"
        )
    follows = bias if g is None else bias + every @ g.T
    turns = collect_turns(t, gyro, np.asarray(follows), rests, force)
    # Earth rate points another way in each rest, unknown here: part of what the bias is not known to.
    bias_covariance = bias_covariance + np.eye(3) * EARTH_RATE**2 / 3 / len(rests)
    try:
        found = calibrate_by_turns(turns, np.sqrt(np.diag(bias_covariance)))
    except CalibrationError as error:
        notes.append(f"gyro scale and misalignments left out: {error}")
        covariance = np.zeros((12, 12))
        covariance[:3, :3] = bias_covariance
        return GyroCalibration(
            Triad(bias), covariance, np.zeros(9, bool), f"bias alone, from {len(rests)} rests", g, g_sigma
        )
    notes.extend(found.dropped)
    if found.complaint:
        notes.append(f"left out: {found.complaint}")
    what = (
        "scale and all six misalignments" if found.seen.all() else "what they show of scale and misalignments"
    )
    method = (
        f"turns between rests, {len(found.used)} of them, gyro against accelerometer: {what} in the "
        f"accelerometer's frame; bias{'' if g is None else ' and g-sensitivity'} from {len(rests)} rests"
    )
    return GyroCalibration(
        Triad(bias + found.bias_change, found.matrix),
        found.covariance + frame_covariance(found, turns, rests, accel),
        found.seen,
        method,
        g,
        g_sigma,
        turns=found,
        held_out=turns_held_out(turns.select(found.used), np.sqrt(np.diag(bias_covariance))),
    )


def _by_earth_rate(rests: Rests, force: Array, latitude: float, notes: list[str]) -> GyroCalibration:
    found = scalar_calibration(rests.gyro, EARTH_RATE, rests.gyro_sigma, name="gyro")
    method = f"Earth rate in {len(rests)} rests by the scalar method"
    rate = found.triad.apply(rests.gyro)
    try:
        noise = np.sqrt((rests.gyro_sigma**2).mean(axis=1))
        alignment = align_by_earth_rate(force, rate, noise, latitude)
    except CalibrationError as error:
        notes.append(f"gyro misalignments by the symmetric convention alone: {error}")
        return GyroCalibration(found.triad, found.full_covariance, np.ones(9, bool), method)
    triad = turned(found.triad, alignment.angle)
    # A small rotation adds [angle x]' to M beside the symmetric part.
    slope = np.zeros((12, 3))
    for k, e in enumerate(np.eye(3)):
        slope[3:, k] = ((turned(triad, 1e-6 * e).matrix - triad.matrix) / 1e-6).ravel()
    covariance = found.full_covariance + slope @ alignment.covariance @ slope.T
    method += (
        "; all six misalignments in the accelerometer's frame from the angle between gravity and Earth rate"
    )
    return GyroCalibration(triad, covariance, np.ones(9, bool), method)


def _by_table(
    t: Array, gyro: Array, rests: Rests, force: Array, table_rate: float, notes: list[str]
) -> GyroCalibration:
    steady, sigma = find_steady_rates(t, gyro, table_rate, rests.gyro.mean(axis=0))
    # Earth rate adds to the table's rate or takes off, by as much as nobody knows here.
    sigma = np.sqrt(sigma**2 + EARTH_RATE**2 / 3)
    found = scalar_calibration(steady, table_rate, sigma, name="gyro")
    method = f"table rate of {table_rate:.6g} rad/s in {len(steady)} steady turns by the scalar method"
    bias_sigma = found.sigma[:3]
    try:
        turns = calibrate_by_turns(collect_turns(t, gyro, found.triad.bias, rests, force), bias_sigma)
        if turns.complaint:
            raise CalibrationError(turns.complaint)
    except CalibrationError as error:
        notes.append(f"gyro misalignments by the symmetric convention alone: {error}")
        return GyroCalibration(found.triad, found.full_covariance, np.ones(9, bool), method)
    # The nearest rotation between both matrices: sizes from the table, the frame from the turns.
    u, _, vt = np.linalg.svd(np.linalg.solve(found.triad.matrix, turns.matrix))
    triad = Triad(found.triad.bias, np.asarray(found.triad.matrix @ u @ vt))
    covariance = found.full_covariance.copy()
    covariance[3:, 3:] += turns.covariance[3:, 3:]
    method += "; all six misalignments in the accelerometer's frame from the turns between rests"
    return GyroCalibration(triad, covariance, np.ones(9, bool), method, turns=turns)
