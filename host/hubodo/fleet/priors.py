"""Derive calibration priors for a new vehicle from the calibrations of a fleet."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa

from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    Quantity,
    format_calibration,
    parse_calibration,
)
from hubodo.errors import InputError
from hubodo.fleet.file_names import CALIBRATION_FILE, PRIORS_FILE
from hubodo.fleet.spread import robust_sigma
from hubodo.fleet.storage import open_file_system, write_atomically

_MIN_VEHICLES = 3
"""Minimum number of vehicles for a prior."""
_ParameterKey = tuple[str, str, str]
"""Node ("" for the vehicle), effect and parameter."""


def write_priors(output: str, rows: pa.Table) -> None:
    """Write `OUT/priors.toml` from the calibration files of these rows of `result_store.SCHEMA`.

    Raises InputError if no parameter is known for three vehicles.
    """
    fs, folder = open_file_system(output)
    calibrations_by_vehicle: dict[str, list[Calibration]] = defaultdict(list)
    for vehicle, files in zip(rows["vehicle"].to_pylist(), rows["files"].to_pylist(), strict=True):
        path = f"{folder}/{files}/{CALIBRATION_FILE}"
        if files and fs.exists(path):
            calibrations_by_vehicle[vehicle].append(parse_calibration(fs.cat_file(path).decode(), Path(path)))
    write_atomically(
        fs, f"{folder}/{PRIORS_FILE}", format_calibration(fleet_calibration(calibrations_by_vehicle)).encode()
    )


def fleet_calibration(calibrations_by_vehicle: Mapping[str, Iterable[Calibration]]) -> Calibration:
    """Return the median over vehicles of each parameter, with the spread between vehicles as sigma.

    Several calibrations of one vehicle are averaged with weights 1/sigma². The sigma is at least that of a
    single calibration. Raises InputError as `write_priors`.
    """
    values: dict[_ParameterKey, list[Quantity]] = defaultdict(list)
    for calibrations in calibrations_by_vehicle.values():
        of_vehicle: dict[_ParameterKey, list[Quantity]] = defaultdict(list)
        for calibration in calibrations:
            for node, effects in _effects_by_node(calibration):
                for effect, it in effects.items():
                    for name, quantity in it.parameters.items():
                        of_vehicle[node, effect, name].append(quantity)
        for place, several in of_vehicle.items():
            values[place].append(_weighted_mean(several))
    priors = {
        place: _median_over_vehicles(some) for place, some in values.items() if len(some) >= _MIN_VEHICLES
    }
    if not priors:
        raise InputError(
            f"priors need a parameter that {_MIN_VEHICLES} vehicles or more have; give more logs"
        )
    calibration = Calibration()
    date = datetime.now(UTC).date().isoformat()
    grouped: dict[str, dict[str, dict[str, Quantity]]] = defaultdict(lambda: defaultdict(dict))
    for (node, effect, name), quantity in priors.items():
        grouped[node][effect][name] = quantity
    method = f"usual among {len(calibrations_by_vehicle)} vehicles"
    for node, by_name in grouped.items():
        calibrated = {name: CalibratedEffect(its, method, "", date) for name, its in by_name.items()}
        calibration = (
            calibration.with_node(node, calibrated, "") if node else calibration.with_vehicle(calibrated)
        )
    return calibration


def _effects_by_node(calibration: Calibration) -> list[tuple[str, Mapping[str, CalibratedEffect]]]:
    return [("", calibration.vehicle), *((name, node.effects) for name, node in calibration.nodes.items())]


def _weighted_mean(estimates: list[Quantity]) -> Quantity:
    """Return the mean with weights 1/sigma²; an exact estimate (sigma 0) is returned unchanged."""
    exact = [one for one in estimates if one.sigma <= 0.0]
    if exact:
        return exact[-1]
    weights = np.array([one.sigma**-2 for one in estimates])
    mean = float(np.average([one.value for one in estimates], weights=weights))
    return Quantity(mean, float(weights.sum() ** -0.5))


def _median_over_vehicles(estimates: list[Quantity]) -> Quantity:
    values = np.array([one.value for one in estimates])
    single_sigma = float(np.median([one.sigma for one in estimates]))
    return Quantity(float(np.median(values)), max(robust_sigma(values), single_sigma))
