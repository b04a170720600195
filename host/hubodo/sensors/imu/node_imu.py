"""Calibration of the IMU of one node: units checked, options of people, whatever sensors it has."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.errors import InputError
from hubodo.log.units import check_node_units
from hubodo.recording import Table
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.result import ImuCalibration
from hubodo.sensors.imu.scalar_calibration import Convention
from hubodo.sensors.imu.unit_change import check_one_unit


@dataclass(frozen=True)
class ImuOptions:
    """Options of an IMU calibration.

    Attributes:
        gravity: local gravity, m/s².
        latitude_deg: makes Earth rate the reference of precise gyros.
        table_rate_deg_s: constant rate of a rate table, as the reference of the gyro.
        convention: accelerometer frame.
        min_standstill: shortest standstill that counts as a pose, s.
        temperature_order: order of the polynomials of the biases in the temperature; None selects it.
    """

    gravity: float = STANDARD_GRAVITY
    latitude_deg: float | None = None
    table_rate_deg_s: float | None = None
    convention: Convention = "symmetric"
    min_standstill: float = 1.0
    temperature_order: int | None = None

    @property
    def latitude(self) -> float | None:
        """Return the latitude, rad."""
        return None if self.latitude_deg is None else math.radians(self.latitude_deg)


def calibrate_node_imu(
    table: Table, node: str, log: str, options: ImuOptions, stated: Iterable[str] = ()
) -> ImuCalibration:
    """Calibrate the triads that a node has; an accelerometer or a gyro alone suffices.

    log: name for errors. stated: sensors whose unit the user stated. Raises InputError for doubtful units or
    a single axis, CalibrationError if the poses do not suffice.
    """
    where = f"{log}, node {node}"
    try:
        check_one_unit(table.t, table.gyro, table.accel)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    check_node_units(table, where, stated)
    rate = options.table_rate_deg_s
    result = calibrate_imu(
        table.t,
        measured_triad(
            table.gyro, where, "gyro", "hubodo calibrate rate calibrates one gyro on a rate table"
        ),
        measured_triad(
            table.accel, where, "accelerometer", "--means with a column such as ref_az calibrates one axis"
        ),
        gravity=options.gravity,
        latitude=options.latitude,
        table_rate=None if rate is None else math.radians(rate),
        convention=options.convention,
        min_standstill=options.min_standstill,
        temperature=table.columns.get("temperature"),
        temperature_order=options.temperature_order,
    )
    return replace(result, node=node)


def measured_triad(values: Array, where: str, name: str, advice: str) -> Array:
    """Return the values (N, 3), or (N, 0) if no axis was measured; raise InputError for some of the axes."""
    measured = np.isfinite(values).any(axis=0)
    if not measured.any():
        return values[:, :0]
    if not measured.all():
        axes = ", ".join("xyz"[k] for k in np.flatnonzero(measured))
        raise InputError(
            f"{where}: has {name} {axes} alone, and the length of a vector needs three axes; {advice}"
        )
    return values
