"""Calibration of one gyro axis from a record on a rate table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.earth import EARTH_RATE
from hubodo.errors import HubodoError, InputError
from hubodo.log.units import check_node_units
from hubodo.recording import Table
from hubodo.sensors.rate_table.fit import fit_rate_table
from hubodo.sensors.rate_table.plateaus import plateaus_from_list, plateaus_from_table
from hubodo.sensors.rate_table.result import RateCalibration


@dataclass(frozen=True)
class RateOptions:
    """Options of a calibration on a rate table.

    Attributes:
        rates: rates in order, rad/s; or
        table: times and rates of the table, s and rad/s.
        settle: time cut at both ends of each plateau, s.
        min_plateau: shortest plateau of a list of rates, s.
        full_scale: rad/s; by default the largest rate.
        latitude: rad, of a table with a vertical axis whose positive rates are counterclockwise.
    """

    rates: Sequence[float] = ()
    table: tuple[Array, Array] | None = None
    settle: float = 1.0
    min_plateau: float = 3.0
    full_scale: float | None = None
    latitude: float | None = None


def calibrate_node_rate(
    table: Table, node: str, axis: str, log: str, options: RateOptions, stated_units: Iterable[str] = ()
) -> RateCalibration:
    """Calibrate one gyro axis of a node of a log, as `calibrate_rate`; errors name log and node.

    stated_units: sensors whose unit the user gave. Raises InputError if the unit is doubtful, too.
    """
    where = f"{log}, node {node}"
    check_node_units(table, where, stated_units)
    try:
        return calibrate_rate(table.t, table["g" + axis], node, axis, options)
    except HubodoError as error:
        raise type(error)(f"{where}: {error}") from None


def calibrate_rate(t: Array, gyro: Array, node: str, axis: str, options: RateOptions) -> RateCalibration:
    """Calibrate one gyro axis, t (N,) s, gyro (N,) rad/s, whose axis is that of the table.

    Raises InputError if samples are missing or the axis does not follow the table, CalibrationError if the
    plateaus do not suffice.
    """
    if not np.isfinite(gyro).all():
        raise InputError(f"g{axis} has samples that are not numbers, or was not measured")
    if options.table is not None:
        plateaus = plateaus_from_table(t, gyro, *options.table, options.settle)
    else:
        plateaus = plateaus_from_list(t, gyro, options.rates, options.settle, options.min_plateau)
    fit = fit_rate_table(plateaus)
    largest = float(np.abs(plateaus.rate).max())
    notes = [*plateaus.notes, "sigmas do not include the error of the table's rates"]
    if options.latitude is None:
        bias = Quantity(fit.bias.value, math.hypot(fit.bias.sigma, EARTH_RATE / math.sqrt(3.0)))
        notes.append("the bias includes Earth rate, and its sigma the size of it: give --latitude-deg")
    else:
        earth = EARTH_RATE * math.sin(options.latitude) * (1.0 + fit.scale_error.value)
        bias = Quantity(fit.bias.value - earth, fit.bias.sigma)
    return RateCalibration(node, axis, options.full_scale or largest, plateaus, fit, bias, tuple(notes))
