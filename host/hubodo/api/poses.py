"""`hubodo.calibrate_means` and `hubodo.plan_poses`: poses of an accelerometer without a log."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hubodo.api.arguments import StrPath
from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.number_file import NumberTable
from hubodo.log.number_recording import IMU_CHANNELS, InputFormat
from hubodo.log.pose_table import pose_table_from_numbers, read_pose_table
from hubodo.sensors.imu.node_imu import ImuOptions
from hubodo.sensors.imu.pose_means import DEFAULT_NODE, calibrate_pose_means
from hubodo.sensors.imu.pose_plan import (
    PLANNED_BIAS_SIGMA,
    PLANNED_TURN_S,
    PosePlan,
    noise_of_accelerometers,
    read_accelerometer_noise,
)
from hubodo.sensors.imu.pose_plan import plan_poses as plan_poses_for_noise
from hubodo.sensors.imu.result import ImuCalibration
from hubodo.sensors.imu.scalar_calibration import Convention
from hubodo.sensors.north.drift import DriftNoise

if TYPE_CHECKING:
    import pandas as pd

    from hubodo.sensors.allan.result import AllanResult


def calibrate_means(
    means: StrPath | pd.DataFrame,
    node: str = DEFAULT_NODE,
    *,
    gravity: float = 9.80665,
    latitude_deg: float | None = None,
    convention: Convention = "symmetric",
    mean_sigma: Mapping[str, float] | None = None,
    units: Sequence[str] = (),
    columns: Sequence[str] = (),
) -> ImuCalibration:
    """Calibrate from means of static poses, one row each, as `hubodo calibrate imu --means` does.

    Parameters
    ----------
    means : str, path-like or pandas.DataFrame
        Table with columns such as `ax`, `sigma_ax` or `std_ax` and `count`, and `ref_ax` (true value).
    node : str
        Name under which the calibration is stored.
    gravity : float
        Local gravity, m/s².
    latitude_deg : float, optional
        Latitude, degrees; makes Earth rate the reference of precise gyros.
    convention : {"symmetric", "x-first"}
        Accelerometer frame: symmetric cross-axis matrix, or x axis along sensor x.
    mean_sigma : mapping of str to float, optional
        1σ of the means by channel (`gx` to `az`), rad/s and m/s²; by default from the table, else from the
        misfit of redundant poses.
    units : sequence of str
        Units of gyro and accelerometer where the headings have none.
    columns : sequence of str
        Meaning of each column; "-" ignores one.

    Returns
    -------
    ImuCalibration
        Bias, scale and cross-axis terms with sigmas.

    Raises
    ------
    InputError
        If the table has no means, a unit is doubtful, or a single axis has no reference.
    CalibrationError
        If the poses do not suffice.

    References
    ----------
    Avrutov, scalar calibration of accelerometers and gyros, eq. 5.
    """
    sigmas = dict(mean_sigma or {})
    for name, sigma in sigmas.items():
        if name not in IMU_CHANNELS or not 0.0 < sigma < math.inf:
            raise InputError(f"mean_sigma {name} = {sigma}: give one above 0, of gx to az")
    stated = (units,) if isinstance(units, str) else tuple(units)
    form = InputFormat(units=stated, columns=tuple(columns))
    if isinstance(means, str | os.PathLike):
        source, table = str(means), read_pose_table(Path(means), form)
    else:
        source = "the data frame"
        table = pose_table_from_numbers(source, _numbers(means), form)
    options = ImuOptions(gravity, latitude_deg, convention=convention)
    return calibrate_pose_means(table, node, source, options, sigmas)


def _numbers(frame: pd.DataFrame) -> NumberTable:
    """Return the columns of a data frame; labels are NaN."""
    values: list[Array] = []
    for position in range(frame.shape[1]):
        try:
            values.append(np.asarray(frame.iloc[:, position], np.float64))
        except (TypeError, ValueError):
            values.append(np.full(len(frame), np.nan))
    if not len(frame) or not values:
        raise InputError("the data frame: has no poses")
    return NumberTable(np.column_stack(values), tuple(map(str, frame.columns)), {})


def plan_poses(
    noise_density: float | None = None,
    *,
    allan: StrPath | AllanResult | None = None,
    bias_instability: float = 0.0,
    bias_sigma: float = PLANNED_BIAS_SIGMA,
    turn: float = PLANNED_TURN_S,
) -> PosePlan:
    """Plan the poses of an accelerometer calibration, as `hubodo calibrate plan` does.

    Parameters
    ----------
    noise_density : float, optional
        Noise of the accelerometers, m/s²/√Hz; or
    allan : str, path-like or AllanResult, optional
        Allan deviation of one accelerometer axis, or the output of `hubodo allan --json`.
    bias_instability : float
        Bias instability beside `noise_density`, m/s².
    bias_sigma : float
        Requested sigma of the biases, m/s².
    turn : float
        Time from pose to pose, s.

    Returns
    -------
    PosePlan
        Which poses, how long, and the sigmas to expect.

    Raises
    ------
    InputError
        Without a noise, or for the Allan deviation of a gyro.
    """
    if (noise_density is None) == (allan is None):
        raise InputError("give the noise: either noise_density or allan, of an accelerometer axis")
    if noise_density is not None:
        for name, value in (("noise_density", noise_density), ("bias_sigma", bias_sigma)):
            if not 0.0 < value < math.inf:
                raise InputError(f"{name} = {value}: give a number above 0")
        noise = DriftNoise(noise_density, bias_instability, 0.0)
    elif isinstance(allan, str | os.PathLike):
        noise = read_accelerometer_noise(Path(allan))
    else:
        assert allan is not None
        noise = noise_of_accelerometers([allan])
    return plan_poses_for_noise(noise, bias_sigma, turn)
