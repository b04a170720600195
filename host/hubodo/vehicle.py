"""Geometry of a vehicle and the mounting of its nodes, from `[vehicle]` and `[nodes.*]` of a TOML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

from hubodo.errors import ConfigError
from hubodo.toml_file import as_table, check_known_keys, check_positive, load_toml, quote_value, read_table

Side = Literal["left", "right"]
Facing = Literal["left", "right"]
RadiusSource = Literal["tape", "rolled", "nominal"]
"""Origin of the wheel radius: measured by tape, from a rolled distance, or from a label or data sheet."""

RADIUS_SOURCES: tuple[RadiusSource, ...] = get_args(RadiusSource)
RANGE_KEYS = ("gyro_range", "accel_range")
_KNOWN_TABLES = ("vehicle", "imu", "nodes", "inputs", "effects", "topics")
_MAX_NAME_LENGTH = 80
PLAUSIBLE_SIZES = {
    "wheel_radius": (0.01, 1.0, "a wheel with a radius"),
    "track_width": (0.05, 10.0, "a track"),
}
"""Least and largest plausible size, m, and its name in errors; `unusual_size = true` allows others."""
_LENGTH_UNITS = {"cm": 0.01, "mm": 0.001, "in": 0.0254}
_MAX_ANTENNA_OFFSET = 1000.0  # m, largest distance of an antenna from the axle


@dataclass(frozen=True, slots=True)
class NodeMount:
    """Mounting of a node.

    Attributes
    ----------
    side : wheel that carries the node; None on the body.
    facing : side to which the z axis of the node points.
    gyro_range, accel_range : rad/s and m/s², at which its samples clip; None if the file does not state them.
    steered : True for a wheel that is steered, or that swivels as a castor does.
    """

    side: Side | None = None
    facing: Facing | None = None
    gyro_range: float | None = None
    accel_range: float | None = None
    steered: bool = False


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Geometry of a vehicle and its nodes, ``[vehicle]`` and ``[nodes.*]`` of a model file.

    Attributes
    ----------
    wheel_radius : m.
    track_width : distance between the contact points of the wheels, m.
    nodes : mounting by node name.
    antenna : position of the GNSS antenna, m forward and left of the midpoint between the wheels; None if
        unknown.
    latitude_deg : latitude of the drives; None if unknown.
    topics : topics in logs of other programs, by node or file (`[topics]`).
    name : name of the vehicle.
    radius_from : how the wheel radius was determined: "nominal", the default, "tape" or "rolled". It sets the
        prior sigma of the radius.
    """

    wheel_radius: float
    track_width: float
    nodes: Mapping[str, NodeMount] = field(default_factory=dict)
    antenna: tuple[float, float] | None = None
    latitude_deg: float | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    name: str = ""
    radius_from: RadiusSource = "nominal"

    def node_on_wheel(self, side: Side) -> str | None:
        """Return the name of the first node on a wheel.

        Parameters
        ----------
        side : {"left", "right"}
            The wheel.

        Returns
        -------
        str or None
            Name of the node, if there is one.
        """
        return next((name for name, mount in self.nodes.items() if mount.side == side), None)


def side_sign(side: Side) -> float:
    """Return +1 for the left wheel, -1 for the right one: the sign of its y coordinate in the body."""
    return 1.0 if side == "left" else -1.0


def facing_sign(facing: Facing) -> float:
    """Return +1 for a node whose z axis points left, -1 for one whose z axis points right."""
    return 1.0 if facing == "left" else -1.0


def load_vehicle(path: Path) -> Vehicle:
    """Read ``[vehicle]``, ``[nodes.*]`` and the ranges in ``[imu]`` of a model or vehicle file.

    Raises ConfigError when a key is unknown, missing or invalid.
    """
    return parse_vehicle(load_toml(path), path)


def parse_vehicle(table: Mapping[str, Any], path: Path | str) -> Vehicle:
    """Return the vehicle of a parsed TOML document, as `load_vehicle`; path: its file, for errors."""
    check_known_keys(table, _KNOWN_TABLES, str(path))
    body = _vehicle_table(table, path)
    if "wheel_diameter" in body:
        raise ConfigError(f"{path}: [vehicle] wheel_diameter: write half of it as wheel_radius, in m")
    size_keys = [item.name for item in fields(_RequiredSizes)]
    check_known_keys(
        body,
        (*size_keys, "radius_from", "antenna", "latitude_deg", "name", "unusual_size"),
        f"{path}: [vehicle]",
    )
    sizes = read_table({k: body[k] for k in body if k in size_keys}, _RequiredSizes, f"{path}: [vehicle]")
    allows_any_size = body.get("unusual_size", False)
    if not isinstance(allows_any_size, bool):
        raise ConfigError(f"{path}: [vehicle] unusual_size: write true or false")
    for item in fields(sizes):
        value, where = getattr(sizes, item.name), f"{path}: [vehicle] {item.name}"
        check_positive(value, where)
        if not allows_any_size:
            check_plausible_size(item.name, value, where)
    imu = as_table(table.get("imu", {}), f"{path}: [imu]")
    common_ranges = _read_ranges(imu, f"{path}: [imu]")
    nodes: dict[str, NodeMount] = {}
    for name, values in as_table(table.get("nodes", {}), f"{path}: [nodes]").items():
        where = f"{path}: [nodes.{name}]"
        entries = as_table(values, where)
        check_known_keys(entries, ("side", "facing", "steered", *RANGE_KEYS, "effects"), where)
        ranges = common_ranges | _read_ranges(entries, where)
        gyro, accel = ranges.get("gyro_range"), ranges.get("accel_range")
        nodes[name] = replace(_read_mount(entries, where), gyro_range=gyro, accel_range=accel)
    antenna = _read_antenna(body, f"{path}: [vehicle] antenna")
    latitude_deg = _read_latitude_deg(body, f"{path}: [vehicle] latitude_deg")
    vehicle_name = body.get("name", "")
    if not isinstance(vehicle_name, str) or len(vehicle_name) > _MAX_NAME_LENGTH:
        raise ConfigError(
            f'{path}: [vehicle] name: write a text of {_MAX_NAME_LENGTH} letters at most, as "van 7"'
        )
    radius_from = body.get("radius_from", "nominal")
    if radius_from not in RADIUS_SOURCES:
        choices = ", ".join(f'"{source}"' for source in RADIUS_SOURCES)
        raise ConfigError(
            f"{path}: [vehicle] radius_from = {quote_value(radius_from)}: how the radius was determined; "
            f"write one of {choices}"
        )
    topics = as_table(table.get("topics", {}), f"{path}: [topics]")
    for name, topic in topics.items():
        if not isinstance(topic, str) or not topic:
            place = f"{path}: [topics] {quote_value(name)} = {quote_value(topic)}"
            raise ConfigError(f'{place}: write a topic, such as "/imu/left"')
    return Vehicle(
        sizes.wheel_radius,
        sizes.track_width,
        nodes,
        antenna,
        latitude_deg,
        dict(topics),
        vehicle_name,
        radius_from,
    )


def _vehicle_table(document: Mapping[str, Any], path: Path | str) -> dict[str, Any]:
    """Return [vehicle]; raise ConfigError if it is missing, or if the document is a calibration."""
    if "vehicle" not in document:
        raise ConfigError(f"{path}: [vehicle] is missing; give wheel_radius and track_width in metres")
    body = as_table(document["vehicle"], f"{path}: [vehicle]")
    if set(body) == {"effects"}:
        raise ConfigError(
            f"{path}: is a calibration, and a vehicle file is due here; give it with --calibration"
        )
    return body


@dataclass(frozen=True, slots=True)
class _RequiredSizes:
    wheel_radius: float
    track_width: float


def check_plausible_size(name: str, value: float, where: str) -> None:
    """Raise ConfigError for a size in metres that is implausible; the error suggests a unit that would fit.

    name: wheel_radius or track_width.
    """
    low, high, quantity = PLAUSIBLE_SIZES[name]
    if low <= value <= high:
        return
    units = [
        f"{value:g} {unit} are {factor * value:.4g}"
        for unit, factor in _LENGTH_UNITS.items()
        if 3.0 * low <= factor * value <= high
    ]
    hint = f" ({' or '.join(units[:2])})" if value > high and units else ""
    raise ConfigError(
        f"{where} = {value:g}: {quantity} of {value:g} m is hardly meant; write metres{hint}, "
        "or add unusual_size = true"
    )


def has_unusual_size(vehicle: Vehicle) -> bool:
    """Return True if sizes are so unusual that a vehicle file must state `unusual_size = true`."""
    return any(not low <= getattr(vehicle, name) <= high for name, (low, high, _) in PLAUSIBLE_SIZES.items())


def _read_antenna(body: Mapping[str, Any], where: str) -> tuple[float, float] | None:
    if "antenna" not in body:
        return None
    match body["antenna"]:
        case [int() | float() as x, int() | float() as y] if (
            abs(x) <= _MAX_ANTENNA_OFFSET and abs(y) <= _MAX_ANTENNA_OFFSET
        ):
            return float(x), float(y)
    raise ConfigError(f"{where}: give [forward, left] in metres, such as [0.5, 0.0]")


def _read_latitude_deg(body: Mapping[str, Any], where: str) -> float | None:
    match body.get("latitude_deg"):
        case None:
            return None
        case bool():
            pass
        case int() | float() as value if abs(value) <= 90.0:
            return float(value)
    raise ConfigError(f"{where}: give degrees north, from -90 to 90")


def _read_ranges(table: Mapping[str, Any], where: str) -> dict[str, float]:
    ranges = {}
    for key in RANGE_KEYS:
        if key in table:
            value = table[key]
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ConfigError(f"{where} {key} = {quote_value(value)}: give a number in rad/s or m/s²")
            ranges[key] = float(value)
            check_positive(ranges[key], f"{where} {key}")
    return ranges


def _read_mount(table: Mapping[str, Any], where: str) -> NodeMount:
    mount = read_table(
        {key: table[key] for key in ("side", "facing", "steered") if key in table}, NodeMount, where
    )
    if (mount.side is None) != (mount.facing is None):
        missing = "side" if mount.side is None else "facing"
        raise ConfigError(f"{where}: {missing} is missing; a node on a wheel has both side and facing")
    return mount
