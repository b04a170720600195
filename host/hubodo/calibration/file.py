"""The calibration file: estimated effects of each node and of the vehicle, with uncertainty and provenance.

One TOML file holds all nodes. Effect and parameter names are those of the model file, so a result can be
passed to the forward model as it is; each value has its 1 sigma, and each effect its provenance:

    [nodes.left]
    serial = "e6614104030a4f2c"

    [nodes.left.effects.gyro_bias]
    method = "rests, 38 of them"
    source_sha256 = "9f2c..."      # of the log it was computed from
    date = "2026-11-21"
    temperature_min = 24.1         # degrees C, range of the log; absent without a thermometer
    temperature_max = 26.0
    x = { value = 0.0021, sigma = 0.00003 }

Effects of the vehicle as a whole are under [vehicle.effects.<name>] in the same form.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hubodo.atomic_files import write_atomically
from hubodo.effects import Effect, effect_of, sort_effects
from hubodo.effects.base import Level
from hubodo.errors import CalibrationError, ConfigError
from hubodo.model.effect_tables import check_value, effect_heading, read_effect_tables
from hubodo.recording import Table
from hubodo.toml_file import (
    as_table,
    check_known_keys,
    load_toml,
    parse_toml,
    quote_value,
    read_table,
    toml_key,
    toml_number,
    toml_text,
)


@dataclass(frozen=True)
class Quantity:
    """A number and its 1 sigma, in the unit of its effect's parameter."""

    value: float
    sigma: float


@dataclass(frozen=True)
class CalibratedEffect:
    """Parameters of one effect and their provenance.

    Attributes
    ----------
    parameters : by name.
    method : how they were estimated, in words.
    source_sha256 : hash of the log.
    date : ISO 8601 day.
    temperature : (lowest, highest) of the log, degrees C; None without a thermometer.
    """

    parameters: Mapping[str, Quantity]
    method: str = ""
    source_sha256: str = ""
    date: str = ""
    temperature: tuple[float, float] | None = None

    def value(self, name: str) -> float:
        """Return the value of a parameter; 0 if it was not determined."""
        return self.parameters[name].value if name in self.parameters else 0.0


@dataclass(frozen=True)
class NodeCalibration:
    """All calibrated effects of one node; serial: serial number of its board, "" if unknown."""

    effects: Mapping[str, CalibratedEffect] = field(default_factory=dict)
    serial: str = ""


@dataclass(frozen=True)
class Calibration:
    """The content of a calibration file.

    Attributes
    ----------
    nodes : mapping of str to NodeCalibration
        Calibrated effects of each node, by name.
    vehicle : mapping of str to CalibratedEffect
        Calibrated effects of the vehicle, by name.
    """

    nodes: Mapping[str, NodeCalibration] = field(default_factory=dict)
    vehicle: Mapping[str, CalibratedEffect] = field(default_factory=dict)

    def with_node(self, name: str, effects: Mapping[str, CalibratedEffect], serial: str = "") -> Calibration:
        """Return a copy with effects of a node added; effects of the same name are replaced.

        Parameters
        ----------
        name : str
            Name of the node.
        effects : mapping of str to CalibratedEffect
            Effects by name.
        serial : str
            Serial number of the board; "" keeps the present one.

        Returns
        -------
        Calibration
            The extended copy.
        """
        old = self.nodes.get(name, NodeCalibration())
        new = NodeCalibration({**old.effects, **effects}, serial or old.serial)
        return replace(self, nodes={**self.nodes, name: new})

    def with_vehicle(self, effects: Mapping[str, CalibratedEffect]) -> Calibration:
        """Return a copy with effects of the vehicle added or replaced.

        Parameters
        ----------
        effects : mapping of str to CalibratedEffect
            Effects by name.

        Returns
        -------
        Calibration
            The extended copy.
        """
        return replace(self, vehicle={**self.vehicle, **effects})


def build_effects(calibrated: Mapping[str, CalibratedEffect]) -> list[Effect]:
    """Return calibrated effects as effects of the model, in the order of the chain.

    Parameters that were not determined are zero. Raises CalibrationError for a value that its parameter
    cannot have.
    """
    effects = []
    for name, effect in calibrated.items():
        kind = effect_of(name)
        values = {parameter: effect.value(parameter) for parameter in kind.parameters()}
        for parameter, value in values.items() if effect.parameters else ():
            problem = kind.invalid_reason(parameter, value)
            if problem:
                raise CalibrationError(
                    f"the calibration's {name} {parameter} = {value:g}: {problem} ({kind.unit(parameter)}); "
                    "add or correct it"
                )
        if effect.parameters:
            effects.append(kind(**values))
    return sort_effects(effects)


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file.

    Raises ConfigError if the file is missing or not TOML, for unknown tables, keys, effects or parameters,
    and for invalid values; the error names file, table, key and the most similar known word.
    """
    return _parse_document(load_toml(path), path)


def parse_calibration(text: str, path: Path) -> Calibration:
    """Return the calibration in the text of a file; path: name of the file, for errors."""
    return _parse_document(parse_toml(text, path), path)


def _parse_document(document: Mapping[str, Any], path: Path) -> Calibration:
    body = document.get("vehicle", {})
    if isinstance(body, dict) and "wheel_radius" in body:
        raise ConfigError(
            f"{path}: describes a vehicle, and a calibration is due here; hubodo calibrate writes one"
        )
    check_known_keys(document, ("nodes", "vehicle"), str(path))
    nodes = {}
    for name, body in as_table(document.get("nodes", {}), f"{path}: [nodes]").items():
        where = f"{path}: [nodes.{toml_key(name)}"
        check_known_keys(body, ("serial", "effects"), f"{where}]")
        refused_levels: dict[Level, str] = {
            "vehicle": "this is an effect of the vehicle; move it to [vehicle.effects.{name}]"
        }
        serial = body.get("serial", "")
        if not isinstance(serial, str):
            raise ConfigError(f"{where}] serial = {quote_value(serial)}: must be a text")
        nodes[name] = NodeCalibration(dict(_read_effects(body, f"{where}.effects", refused_levels)), serial)
    vehicle = as_table(document.get("vehicle", {}), f"{path}: [vehicle]")
    check_known_keys(vehicle, ("effects",), f"{path}: [vehicle]")
    return Calibration(nodes, dict(_read_effects(vehicle, f"{path}: [vehicle.effects", {})))


def write_calibration(calibration: Calibration, path: Path) -> None:
    """Write a calibration file completely or not at all; an existing file is replaced.

    To add to an existing calibration, merge with `Calibration.with_node` first.
    """
    write_atomically(path, format_calibration(calibration))


def format_calibration(calibration: Calibration) -> str:
    """Return the text of the file; numbers keep all their digits."""
    lines = ["# Written by hubodo calibrate; SI units, names of the model file, value and 1 sigma."]
    for name, node in calibration.nodes.items():
        lines += ["", f"[nodes.{toml_key(name)}]"]
        if node.serial:
            lines.append(f"serial = {toml_text(node.serial)}")
        lines += _format_effects(f"nodes.{toml_key(name)}.effects", node.effects)
    return "\n".join([*lines, *_format_effects("vehicle.effects", calibration.vehicle)]) + "\n"


def find_node_serial(metadata: Mapping[str, str], node: str) -> str:
    """Return the serial of a node from a log's metadata, "" when they have none.

    A recorded log has the serial in the record of the node; other logs may state it as `serial.<node>`.
    """
    return metadata.get(f"node.{node}.serial") or metadata.get(f"serial.{node}", "")


def find_temperature_span(table: Table) -> tuple[float, float] | None:
    """Return the lowest and highest temperature of a node's table, °C, or None without any reading."""
    if "temperature" not in table:
        return None
    known = table["temperature"][np.isfinite(table["temperature"])]
    return (float(known.min()), float(known.max())) if len(known) else None


def hash_source(path: Path) -> str:
    """Return the SHA-256 of a log file, or of all files of a CSV folder in order of their names."""
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()


def _format_effects(table: str, effects: Mapping[str, CalibratedEffect]) -> list[str]:
    lines: list[str] = []
    for name, effect in effects.items():
        lines += ["", effect_heading(table, name)]
        texts = {"method": effect.method, "source_sha256": effect.source_sha256, "date": effect.date}
        lines += [f"{key} = {toml_text(text)}" for key, text in texts.items() if text]
        if effect.temperature is not None:
            lines.append(f"temperature_min = {toml_number(effect.temperature[0])}")
            lines.append(f"temperature_max = {toml_number(effect.temperature[1])}")
        lines += [
            f"{toml_key(parameter)} = {{ value = {toml_number(q.value)}, sigma = {toml_number(q.sigma)} }}"
            for parameter, q in effect.parameters.items()
        ]
    return lines


@dataclass(frozen=True)
class _Provenance:
    method: str = ""
    source_sha256: str = ""
    date: str = ""
    temperature_min: float | None = None
    temperature_max: float | None = None


def _read_effects(
    table: Mapping[str, Any], where: str, refused_levels: Mapping[Level, str]
) -> Iterator[tuple[str, CalibratedEffect]]:
    provenance_keys = [item.name for item in fields(_Provenance)]
    for kind, values, place in read_effect_tables(table, where, refused_levels):
        check_known_keys(values, (*provenance_keys, *kind.parameters()), place)
        parameters = {
            name: _read_quantity(kind, name, values[name], f"{place} {name}")
            for name in kind.parameters()
            if name in values
        }
        provenance = read_table(
            {key: values[key] for key in provenance_keys if key in values}, _Provenance, place
        )
        low, high = provenance.temperature_min, provenance.temperature_max
        span = None if low is None or high is None else (low, high)
        yield (
            kind.name,
            CalibratedEffect(parameters, provenance.method, provenance.source_sha256, provenance.date, span),
        )


def _read_quantity(kind: type[Effect], name: str, body: object, where: str) -> Quantity:
    quantity = read_table(body, Quantity, where)
    check_value(kind, name, quantity.value, f"{where} value")
    if not math.isfinite(quantity.sigma):
        raise ConfigError(f"{where} sigma = {quantity.sigma}: must be a finite number")
    if quantity.sigma < 0.0:
        raise ConfigError(f"{where} sigma = {quantity.sigma}: is negative; it is a standard deviation")
    return quantity
