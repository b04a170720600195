"""The calibration file: what was learnt about each node, as effects of the model with their uncertainty.

One TOML file holds all nodes. Effect and parameter names are those of the model file, so a result can be
handed to the forward model as it stands; beside each value stands its 1 sigma, and beside each effect where
it came from:

    [nodes.left]
    serial = "e6614104030a4f2c"

    [nodes.left.effects.gyro_bias]
    method = "rests, 38 of them"
    source_sha256 = "9f2c..."      # of the log it was computed from
    date = "2026-11-21"
    temperature_min = 24.1         # degrees C, span of the log; left out when there was no thermometer
    temperature_max = 26.0
    x = { value = 0.0021, sigma = 0.00003 }

Effects of the vehicle as a whole stand under [vehicle.effects.<name>] in the same form.
"""

from __future__ import annotations

import difflib
import hashlib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hubodo.errors import ConfigError, InputError
from hubodo.toml_file import toml_key, toml_number, toml_text, write_whole

XYZ = ("x", "y", "z")
NONORTHOGONALITY = ("xz", "xy", "yz", "yx", "zy", "zx")

PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "gyro_bias": XYZ,
    "gyro_warmup": (*XYZ, "time_constant"),
    "gyro_temperature": XYZ,
    "gyro_g_sensitivity": (*XYZ, "xx", "xy", "xz", "yx", "yy", "yz"),
    "gyro_rate_random_walk": ("k",),
    "gyro_scale_factor": XYZ,
    "gyro_nonorthogonality": NONORTHOGONALITY,
    "gyro_cubic": ("z",),
    "accel_bias": XYZ,
    "accel_scale_factor": XYZ,
    "accel_nonorthogonality": NONORTHOGONALITY,
    "node_misalignment": XYZ,
    "lever_arm": XYZ,
    "wheel_radius": ("error",),
    "track_width": ("error",),
}
"""Effects that a calibration file may hold, and their parameters, in the units of the model.

`gyro_g_sensitivity` has the model's x, y, z for the z gyro; xy and so on say how the x gyro answers f_y.
"""

_PROVENANCE = ("method", "source_sha256", "date", "temperature_min", "temperature_max")


@dataclass(frozen=True)
class Quantity:
    """A number and its 1 sigma, in the unit of its effect."""

    value: float
    sigma: float


@dataclass(frozen=True)
class CalibratedEffect:
    """Parameters of one effect and where they came from.

    method: how it was found, in words. source_sha256: hash of the log. date: ISO 8601 day.
    temperature: (lowest, highest) of the log, degrees C, None without a thermometer.
    """

    parameters: Mapping[str, Quantity]
    method: str = ""
    source_sha256: str = ""
    date: str = ""
    temperature: tuple[float, float] | None = None

    def value(self, name: str) -> float:
        """The parameter's value, 0 when it was not determined."""
        return self.parameters[name].value if name in self.parameters else 0.0


@dataclass(frozen=True)
class NodeCalibration:
    """All effects known of one node; serial: the node's own number, "" when the log did not tell."""

    effects: Mapping[str, CalibratedEffect] = field(default_factory=dict)
    serial: str = ""


@dataclass(frozen=True)
class Calibration:
    """What a calibration file holds: nodes by name, and effects of the whole vehicle."""

    nodes: Mapping[str, NodeCalibration] = field(default_factory=dict)
    vehicle: Mapping[str, CalibratedEffect] = field(default_factory=dict)

    def with_node(self, name: str, effects: Mapping[str, CalibratedEffect], serial: str = "") -> Calibration:
        """The same with these effects of a node added; effects of the same name are replaced, others stay."""
        old = self.nodes.get(name, NodeCalibration())
        new = NodeCalibration({**old.effects, **effects}, serial or old.serial)
        return replace(self, nodes={**self.nodes, name: new})

    def with_vehicle(self, effects: Mapping[str, CalibratedEffect]) -> Calibration:
        """The same with these effects of the vehicle added or replaced."""
        return replace(self, vehicle={**self.vehicle, **effects})


def read_calibration(path: Path) -> Calibration:
    """Read a calibration file. Raises ConfigError: not TOML, unknown or missing key, a value that is no
    number."""
    try:
        return parse_calibration(path.read_text(encoding="utf-8"), path)
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is no TOML: {error}; write it with hubodo calibrate") from None
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give an existing calibration file") from None


def parse_calibration(text: str, path: Path) -> Calibration:
    """The calibration in the text of a file; path: where it stood. Errors as of `read_calibration`."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is no TOML: {error}; write it with hubodo calibrate") from None
    _check(path, "the file", document, ("nodes", "vehicle"))
    nodes = {}
    for name, body in _table(path, "nodes", document.get("nodes", {})).items():
        _check(path, f"nodes.{name}", body, ("serial", "effects"))
        effects = _effects(path, f"nodes.{name}.effects", body.get("effects", {}))
        nodes[name] = NodeCalibration(effects, str(body.get("serial", "")))
    vehicle = _table(path, "vehicle", document.get("vehicle", {}))
    _check(path, "vehicle", vehicle, ("effects",))
    return Calibration(nodes, _effects(path, "vehicle.effects", vehicle.get("effects", {})))


def write_calibration(calibration: Calibration, path: Path) -> None:
    """Write the file whole or not at all; an existing file is replaced. Merge with `with_node` beforehand."""
    write_whole(path, calibration_toml(calibration))


def calibration_toml(calibration: Calibration) -> str:
    """The text of the file; numbers keep all their digits."""
    lines = ["# Written by hubodo calibrate; SI units, names of the model file, value and 1 sigma."]
    for name, node in calibration.nodes.items():
        lines += ["", f"[nodes.{toml_key(name)}]"]
        if node.serial:
            lines.append(f"serial = {toml_text(node.serial)}")
        lines += _effect_lines(f"nodes.{toml_key(name)}.effects", node.effects)
    return "\n".join([*lines, *_effect_lines("vehicle.effects", calibration.vehicle)]) + "\n"


def node_serial(metadata: Mapping[str, str], node: str) -> str:
    """The serial of a node as a log's metadata tell it, "" when they do not.

    A recorded log has it in the record of the node, other logs may state it as `serial.<node>`.
    """
    return metadata.get(f"node.{node}.serial") or metadata.get(f"serial.{node}", "")


def source_hash(path: Path) -> str:
    """SHA-256 of a log file, or of all files of a CSV folder in order of their names."""
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()


def _effect_lines(prefix: str, effects: Mapping[str, CalibratedEffect]) -> list[str]:
    lines: list[str] = []
    for name, effect in effects.items():
        lines += ["", f"[{prefix}.{toml_key(name)}]"]
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


def _effects(path: Path, where: str, body: Any) -> dict[str, CalibratedEffect]:
    found = {}
    for name, table in _table(path, where, body).items():
        if name not in PARAMETERS:
            raise ConfigError(f"{path}: {where}.{name} is no effect{_near(name, PARAMETERS)}")
        _check(path, f"{where}.{name}", table, (*_PROVENANCE, *PARAMETERS[name]))
        parameters = {
            parameter: _quantity(path, f"{where}.{name}.{parameter}", table[parameter])
            for parameter in PARAMETERS[name]
            if parameter in table
        }
        span = (table.get("temperature_min"), table.get("temperature_max"))
        temperature = None if None in span else (float(span[0]), float(span[1]))
        method, source, date = (str(table.get(key, "")) for key in _PROVENANCE[:3])
        found[name] = CalibratedEffect(parameters, method, source, date, temperature)
    return found


def _quantity(path: Path, where: str, body: Any) -> Quantity:
    _check(path, where, _table(path, where, body), ("value", "sigma"))
    numbers = [body.get(key) for key in ("value", "sigma")]
    for key, number in zip(("value", "sigma"), numbers, strict=True):
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
            raise ConfigError(f"{path}: {where}.{key} must be a finite number, is {number!r}")
    if numbers[1] < 0:
        raise ConfigError(f"{path}: {where}.sigma is negative; it is a standard deviation")
    return Quantity(float(numbers[0]), float(numbers[1]))


def _table(path: Path, where: str, body: Any) -> Mapping[str, Any]:
    if not isinstance(body, Mapping):
        raise ConfigError(f"{path}: {where} must be a table, is {body!r}")
    return body


def _check(path: Path, where: str, body: Any, known: Iterable[str]) -> None:
    for key in _table(path, where, body):
        if key not in known:
            raise ConfigError(f"{path}: unknown key {key!r} in {where}{_near(key, known)}")


def _near(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), 1)
    return f"; did you mean {close[0]!r}?" if close else f"; known are {', '.join(known)}"
