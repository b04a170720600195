"""Attitude of a node on a turntable from gravity, and checks of turn direction and table tilt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array, find_runs
from hubodo.earth import EARTH_RATE
from hubodo.errors import InputError
from hubodo.sensors.north.stops import TableMotion

MAX_ELEVATION = np.radians(30)
WARN_ELEVATION = np.radians(2)
MIN_CHECKED_TURN = np.radians(60)
_MIN_UNAMBIGUOUS_RATE = np.radians(5)
"""Turn rate, rad/s, whose sign the bias of a gyro cannot hide if the table never stands."""

_MIN_SENSE_STOPS, _MIN_STOP_SAMPLES = 4, 20
_SENSE_CHI_SQUARE = 20.0
"""Twice the log likelihood ratio of both senses of turning, 4.5 sigma, from which gravity decides."""


@dataclass(frozen=True)
class AxisMount:
    """The attitude of one axis of a node on the table.

    Attributes:
        axis: "x", "y" or "z".
        up: (3,) unit vector in node axes.
        mounting_angle: angle of the axis, anticlockwise from table zero, at table angle zero, rad.
        level_share: cosine of the axis's elevation, the share of horizontal Earth rate that it measures.
        vertical_rate: (N,) rate about the vertical, rad/s.
        elevation_sine: (N,) sine of the axis's elevation.
        warnings: one line each.
    """

    axis: str
    up: Array
    mounting_angle: float
    level_share: float
    vertical_rate: Array
    elevation_sine: Array
    warnings: tuple[str, ...]


def estimate_mount(gyro: Array, accel: Array, axis: str) -> AxisMount:
    """Return the attitude of an axis from gravity; without accelerometer, z is assumed upright.

    gyro: (N, 3) rad/s. accel: (N, 3) m/s². axis: "x", "y" or "z". With z vertical, x is table zero and y a
    quarter turn anticlockwise from it (clockwise if z points down); in any other attitude the axis itself
    is table zero. Raises InputError if the axis is too steep to measure horizontal Earth rate.
    """
    force = accel.mean(axis=0)
    norm = float(np.linalg.norm(force))
    up = force / norm if norm > 1.0 else np.array([0.0, 0.0, 1.0])
    index = "xyz".index(axis)
    elevation = float(np.arcsin(np.clip(up[index], -1, 1)))
    if abs(elevation) > MAX_ELEVATION:
        raise InputError(
            f"axis {axis} is {np.degrees(elevation):+.0f} degrees from level and measures little of "
            "horizontal Earth rate; choose an axis that is level on the table"
        )
    warnings = []
    if abs(elevation) > WARN_ELEVATION:
        warnings.append(
            f"axis {axis} is {np.degrees(elevation):+.1f} degrees off level (or the accelerometer is not "
            f"calibrated); its reading, {100 * (1 - np.cos(elevation)):.2f} % too low, is corrected"
        )
    mounting = 0.0
    if abs(up[2]) > 0.7:
        mounting = np.pi / 2 * np.sign(up[2]) if axis == "y" else 0.0
    else:
        warnings.append(f"z is not vertical, so azimuth is that of axis {axis} at table angle zero")
    elevation_sine = accel[:, index] / norm if norm > 1.0 else np.zeros(len(accel))
    level = float(np.cos(elevation))
    return AxisMount(axis, up, float(mounting), level, np.asarray(gyro @ up), elevation_sine, tuple(warnings))


def vertical_earth_rate(mount: AxisMount, latitude: float) -> Array:
    """Return the (N,) component of vertical Earth rate along the axis, rad/s, due to its elevation.

    The elevation comes from the accelerometer, whose bias is constant and therefore acts like the gyro's.
    It is zero for a node without accelerometer. latitude: rad.
    """
    return np.asarray(EARTH_RATE * np.sin(latitude) * mount.elevation_sine)


def check_turn_direction(mount: AxisMount, t: Array, table: TableMotion) -> None:
    """Raise InputError if the turns of the vertical gyro contradict the table file (sign or unit)."""
    angle = table.angle_at(t)
    step = np.gradient(t)
    steps = np.diff(angle, append=angle[-1])
    turning = np.abs(steps) > 1e-9
    if float(np.abs(steps).sum()) < MIN_CHECKED_TURN:
        return
    bias = 0.0
    if np.count_nonzero(~turning) > 1:
        bias = float(np.median(mount.vertical_rate[~turning]))
    elif float(np.median(np.abs(steps[turning] / step[turning]))) < _MIN_UNAMBIGUOUS_RATE:
        return
    measured = (mount.vertical_rate - bias) * step
    ratio = float((measured * np.sign(steps))[turning].sum() / np.abs(steps)[turning].sum())
    if 40 < abs(ratio) < 80:
        raise InputError(
            f"the integrated vertical rate is {abs(ratio):.0f} times the turns of the table, as if it were "
            "in degrees per second; convert the record to rad/s"
        )
    if -1.4 < ratio < -0.6:
        raise InputError(
            "table.csv: the angle grows clockwise (the vertical gyro measured the opposite turn); it must "
            "grow anticlockwise seen from above: change its sign"
        )


def confirm_turn_sense(mount: AxisMount, t: Array, accel: Array, table: TableMotion) -> bool:
    """Return True if gravity confirms the sense of angles that the gyro measured, False if it shows neither.

    On a table that leans, gravity turns clockwise in the node as the table turns anticlockwise; on a level
    one it does not turn. Raises InputError if it turns the other way: an axis of the gyro is reversed.
    """
    horizontal = np.linalg.svd(mount.up[None])[2][1:]
    horizontal[1] *= np.sign(np.linalg.det(np.vstack([horizontal, mount.up])))
    stops = [(i, j) for i, j in find_runs(~table.moving_at(t)) if j - i >= _MIN_STOP_SAMPLES]
    if len(stops) < _MIN_SENSE_STOPS or not np.linalg.norm(accel.mean(axis=0)) > 1.0:
        return False
    force = np.array([accel[i:j].mean(axis=0) for i, j in stops]) @ horizontal.T
    angle = table.angle_at(np.array([t[(i + j) // 2] for i, j in stops]))
    misfit = []
    for sense in (1.0, -1.0):
        design = np.column_stack([np.ones(len(stops)), np.exp(-1j * sense * angle)])
        values = force[:, 0] + 1j * force[:, 1]
        residual = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
        misfit.append(float(np.vdot(residual, residual).real))
    # Twice the log likelihood ratio for an unknown noise is the number of values times the logarithm.
    support = 2 * len(stops) * np.log(max(misfit[1], 1e-300) / max(misfit[0], 1e-300))
    if support < -_SENSE_CHI_SQUARE:
        raise InputError(
            "the table leans, and gravity turns against the turns of the gyro: an axis of the gyro is "
            "reversed, or gyro and accelerometer have different axes; correct the signs "
            "(hubodo calibrate imu names the axis)"
        )
    return bool(support > _SENSE_CHI_SQUARE)


def describe_table_tilt(mount: AxisMount, t: Array, table: TableMotion) -> list[str]:
    """Return one line if the table's axis is tilted significantly from the vertical, else no line."""
    covered = (t >= table.t[0]) & (t <= table.t[-1])
    angle = (table.angle_at(t) + mount.mounting_angle)[covered]
    elevation_sine = mount.elevation_sine[covered]
    if len(angle) < 100 or not np.ptp(elevation_sine):
        return []
    design = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
    if np.linalg.cond(design) > 1e3:
        design = design[:, :2]
    coefficients = np.linalg.lstsq(design, elevation_sine, rcond=None)[0]
    tilt = float(np.linalg.norm(coefficients[1:]))
    noise = float((elevation_sine - design @ coefficients).std()) * np.sqrt(4 / len(elevation_sine))
    if tilt < max(5 * noise, 1e-3):
        return []
    return [
        f"the table's axis is tilted by {np.degrees(tilt):.2f} degrees: vertical Earth rate is corrected, "
        "the gyro's g-sensitivity is not; level the table"
    ]
