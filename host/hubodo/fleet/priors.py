"""What is usual among the vehicles of a fleet, as a calibration file: where to begin with one more."""

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
from hubodo.fleet.names import CALIBRATION, PRIORS
from hubodo.fleet.place import opened, write_whole
from hubodo.fleet.spread import robust_sigma

_FEWEST = 3
"""Vehicles that make a spread."""
_Place = tuple[str, str, str]
"""Node, "" for the vehicle; effect; parameter."""


def write_priors(output: str, rows: pa.Table) -> None:
    """`OUT/priors.toml` from the calibration files of these rows of `finished.SCHEMA`.

    Raises InputError where no parameter is known of three vehicles.
    """
    fs, folder = opened(output)
    found: dict[str, list[Calibration]] = defaultdict(list)
    for vehicle, files in zip(rows["vehicle"].to_pylist(), rows["files"].to_pylist(), strict=True):
        path = f"{folder}/{files}/{CALIBRATION}"
        if files and fs.exists(path):
            found[vehicle].append(parse_calibration(fs.cat_file(path).decode(), Path(path)))
    write_whole(fs, f"{folder}/{PRIORS}", format_calibration(usual(found)).encode())


def usual(found: Mapping[str, Iterable[Calibration]]) -> Calibration:
    """The median over vehicles of each parameter, with the spread between them as its sigma.

    Of a vehicle with several calibrations the mean counts, weighted by sigma. The sigma is never below that
    of a single calibration. Raises InputError as `write_priors`.
    """
    values: dict[_Place, list[Quantity]] = defaultdict(list)
    for calibrations in found.values():
        own: dict[_Place, list[Quantity]] = defaultdict(list)
        for calibration in calibrations:
            for node, effects in _by_node(calibration):
                for effect, it in effects.items():
                    for name, quantity in it.parameters.items():
                        own[node, effect, name].append(quantity)
        for place, several in own.items():
            values[place].append(_mean(several))
    common = {place: _usual(some) for place, some in values.items() if len(some) >= _FEWEST}
    if not common:
        raise InputError(f"priors need a parameter that {_FEWEST} vehicles or more have; give more logs")
    made = Calibration()
    date = datetime.now(UTC).date().isoformat()
    grouped: dict[str, dict[str, dict[str, Quantity]]] = defaultdict(lambda: defaultdict(dict))
    for (node, effect, name), quantity in common.items():
        grouped[node][effect][name] = quantity
    method = f"usual among {len(found)} vehicles"
    for node, by_name in grouped.items():
        ready = {name: CalibratedEffect(its, method, "", date) for name, its in by_name.items()}
        made = made.with_node(node, ready, "") if node else made.with_vehicle(ready)
    return made


def _by_node(calibration: Calibration) -> list[tuple[str, Mapping[str, CalibratedEffect]]]:
    return [("", calibration.vehicle), *((name, node.effects) for name, node in calibration.nodes.items())]


def _mean(several: list[Quantity]) -> Quantity:
    """By weight of sigma; one without a sigma counts alone."""
    exact = [one for one in several if one.sigma <= 0.0]
    if exact:
        return exact[-1]
    weights = np.array([one.sigma**-2 for one in several])
    mean = float(np.average([one.value for one in several], weights=weights))
    return Quantity(mean, float(weights.sum() ** -0.5))


def _usual(some: list[Quantity]) -> Quantity:
    values = np.array([one.value for one in some])
    least = float(np.median([one.sigma for one in some]))
    return Quantity(float(np.median(values)), max(robust_sigma(values), least))
