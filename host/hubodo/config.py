"""Configuration files at the edge of a verb: TOML to frozen dataclasses, with every key accounted for."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints

from hubodo.errors import ConfigError
from hubodo.model.frames import Facing, Side
from hubowire.budget import UART_BAUD

_MODEL_TABLES = ("vehicle", "imu", "nodes", "inputs", "effects")
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class NodeMount:
    """Where a node sits. side: which wheel, None on the body; facing: where its z axis points."""

    side: Side | None = None
    facing: Facing | None = None


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Geometry of a vehicle and its nodes, ``[vehicle]`` and ``[nodes.*]`` of a model file.

    wheel_radius, track_width (between contacts): m. nodes: by name.
    """

    wheel_radius: float
    track_width: float
    nodes: Mapping[str, NodeMount] = field(default_factory=dict)

    def on(self, side: Side) -> str | None:
        """The name of the first node on that wheel, None where there is none."""
        return next((name for name, mount in self.nodes.items() if mount.side == side), None)


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """``[record]`` of hubodo.toml: defaults for `hubodo record`; the command line goes before them.

    ports: as on the command line. duration: s, None until stopped. odometry_rate_hz: poses a second at most,
    None: one for every sample.
    clock_request_period: s between two questions for a node's clock.
    time_scale, time_zero_ns: for emulated nodes that are slower than real time: a second of the log takes
    time_scale seconds, from this host time (ns since 1970) on; None: from the start on.
    """

    ports: tuple[str, ...] = ()
    output: str | None = None
    vehicle: str | None = None
    calibration: str | None = None
    gnss: str | None = None
    gnss_baud: int = 9600
    baud: int = UART_BAUD
    wait: bool = False
    duration: float | None = None
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    odometry_rate_hz: float | None = None
    clock_request_period: float = 1.0
    time_scale: float = 1.0
    time_zero_ns: int | None = None


def load_record_config(path: Path) -> RecordConfig:
    """Reads hubodo.toml.

    Paths in it (output, vehicle, calibration) are relative to the file. Raises ConfigError at the first key
    that is unknown or of the wrong type.
    """
    table = load_toml(path)
    only_keys(table, ("record",), str(path))
    config = read_table(table.get("record", {}), RecordConfig, f"{path}: [record]")
    for key in ("gnss_baud", "baud", "odometry_rate_hz", "clock_request_period", "time_scale"):
        if getattr(config, key) is not None and not getattr(config, key) > 0:
            raise ConfigError(f"{path}: [record] {key} = {getattr(config, key)}: must be above 0")
    if config.duration is not None and not config.duration > 0:
        raise ConfigError(f"{path}: [record] duration = {config.duration}: must be above 0")
    return config


def load_vehicle(path: Path) -> Vehicle:
    """Reads ``[vehicle]`` and ``[nodes.*]`` of a model or vehicle file; its other tables are not looked at.

    Raises ConfigError when a key is unknown, missing or impossible.
    """
    return vehicle_of(load_toml(path), path)


def vehicle_of(table: Mapping[str, Any], path: Path | str) -> Vehicle:
    """`load_vehicle` of a document that is already parsed; path: where it stood, for the errors."""
    only_keys(table, _MODEL_TABLES, str(path))
    if "vehicle" not in table:
        raise ConfigError(f"{path}: [vehicle] is missing; give wheel_radius and track_width in metres")
    body = as_table(table["vehicle"], f"{path}: [vehicle]")
    only_keys(body, ("wheel_radius", "track_width"), f"{path}: [vehicle]")
    sizes = read_table(body, _Sizes, f"{path}: [vehicle]")
    for item in fields(sizes):
        value = getattr(sizes, item.name)
        if not (math.isfinite(value) and value > 0):
            raise ConfigError(f"{path}: [vehicle] {item.name} = {value}: must be above 0 (metres)")
    nodes: dict[str, NodeMount] = {}
    for name, values in as_table(table.get("nodes", {}), f"{path}: [nodes]").items():
        where = f"{path}: [nodes.{name}]"
        entries = as_table(values, where)
        only_keys(entries, ("side", "facing", "effects"), where)
        nodes[name] = _mount(entries, where)
    return Vehicle(sizes.wheel_radius, sizes.track_width, nodes)


@dataclass(frozen=True, slots=True)
class _Sizes:
    wheel_radius: float
    track_width: float


def _mount(table: Mapping[str, Any], where: str) -> NodeMount:
    sides = ("left", "right")
    for key in ("side", "facing"):
        value = table.get(key)
        if value is not None and value not in sides:
            raise ConfigError(f"{where} {key} = {value!r}: write left or right{near(str(value), sides)}")
    if ("side" in table) != ("facing" in table):
        missing = "facing" if "side" in table else "side"
        raise ConfigError(f"{where}: {missing} is missing; a node on a wheel has both side and facing")
    return NodeMount(cast(Side | None, table.get("side")), cast(Facing | None, table.get("facing")))


def read_table(table: object, shape: type[_T], where: str) -> _T:
    """A TOML table as a frozen dataclass of str, int, float, bool, Literal of texts and lists of str.

    where: file and table, for the error. Raises ConfigError when a key is unknown (with the nearest
    known one), missing, or its value has another type.
    """
    entries = as_table(table, where)
    hints = get_type_hints(shape)
    items = fields(cast(Any, shape))
    only_keys(entries, [item.name for item in items], where)
    values: dict[str, Any] = {}
    for item in items:
        if item.name in entries:
            values[item.name] = _value(entries[item.name], hints[item.name], f"{where} {item.name}")
        elif item.default is MISSING and item.default_factory is MISSING:
            raise ConfigError(f"{where}: {item.name} is missing; add it")
    return shape(**values)


def _value(value: object, hint: Any, where: str) -> Any:
    if hint == tuple[str, ...]:
        if isinstance(value, list) and all(isinstance(entry, str) for entry in value):
            return tuple(value)
        raise ConfigError(f"{where} = {value!r}: must be a list of texts")
    if get_origin(hint) is Literal:
        if value in get_args(hint):
            return value
        raise ConfigError(
            f"{where} = {value!r}: write {' or '.join(get_args(hint))}{near(str(value), get_args(hint))}"
        )
    text = str(hint)
    if isinstance(value, bool) or hint is bool:
        if isinstance(value, bool) and "bool" in text:
            return value
    elif isinstance(value, int | float) and "float" in text:
        return float(value)
    elif (isinstance(value, int) and "int" in text) or (isinstance(value, str) and "str" in text):
        return value
    names = {"float": "a number", "int": "a whole number", "bool": "true or false", "str": "a text"}
    wanted = next(words for name, words in names.items() if name in text)
    raise ConfigError(f"{where} = {value!r}: must be {wanted}")


def load_toml(path: Path) -> dict[str, Any]:
    """A TOML document. Raises ConfigError: no such file, not readable, not TOML."""
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path}: cannot be read ({error}); check the path and that it is UTF-8 text"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not TOML: {error}; correct that line") from None


def as_table(value: object, where: str) -> dict[str, Any]:
    """The value itself; raises ConfigError when it is no table. where: file and table, for the error."""
    if isinstance(value, dict):
        return value
    raise ConfigError(f"{where} = {value!r}: must be a table")


def only_keys(table: object, known: Iterable[str], where: str) -> None:
    """Raises ConfigError at the first key that is not known, with the nearest one that is."""
    names = list(known)
    for key in as_table(table, where):
        if key not in names:
            raise ConfigError(f"{where}: unknown key {key!r}{near(key, names)}; known are {', '.join(names)}")


def near(word: str, known: Iterable[str]) -> str:
    """ ", did you mean ...?" for an error about a word that is not known; "" where none is like it."""
    close = difflib.get_close_matches(word, list(known), 1, 0.5)
    return f", did you mean {close[0]!r}?" if close else ""
