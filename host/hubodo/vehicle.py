"""A vehicle's geometry and where its nodes sit, as `[vehicle]` and `[nodes.*]` of a TOML file say it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

from hubodo.errors import ConfigError
from hubodo.toml_file import above_zero, as_table, load_toml, only_keys, read_table, shown

Side = Literal["left", "right"]
Facing = Literal["left", "right"]

RANGES = ("gyro_range", "accel_range")
_MODEL_TABLES = ("vehicle", "imu", "nodes", "inputs", "effects", "topics")
_LONGEST_NAME = 80
_FARTHEST = 1000.0  # m, of an antenna from the axle


@dataclass(frozen=True, slots=True)
class NodeMount:
    """Where a node sits.

    side: which wheel, None on the body; facing: where its z axis points. steered: whether that wheel is
    turned to steer, or turns by itself as a castor does. gyro_range: rad/s, accel_range: m/s², where its
    samples end; None where the file does not say.
    """

    side: Side | None = None
    facing: Facing | None = None
    gyro_range: float | None = None
    accel_range: float | None = None
    steered: bool = False


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Geometry of a vehicle and its nodes, ``[vehicle]`` and ``[nodes.*]`` of a model file.

    wheel_radius, track_width (between contacts): m. nodes: by name. antenna: m forward and left of midway
    between the wheels, of what tells positions; latitude_deg: where on Earth it drives; None where these are
    not known. topics: of other programs' logs, by node or file (`[topics]`).
    """

    wheel_radius: float
    track_width: float
    nodes: Mapping[str, NodeMount] = field(default_factory=dict)
    antenna: tuple[float, float] | None = None
    latitude_deg: float | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    name: str = ""

    def on(self, side: Side) -> str | None:
        """The name of the first node on that wheel, None where there is none."""
        return next((name for name, mount in self.nodes.items() if mount.side == side), None)


def side_sign(side: Side) -> float:
    """+1 for the left wheel, -1 for the right one: the sign of its y coordinate in the body."""
    return 1.0 if side == "left" else -1.0


def facing_sign(facing: Facing) -> float:
    """+1 for a node whose z axis points left, -1 for one whose z axis points right."""
    return 1.0 if facing == "left" else -1.0


def load_vehicle(path: Path) -> Vehicle:
    """Reads ``[vehicle]``, ``[nodes.*]`` and the ranges in ``[imu]`` of a model or vehicle file.

    Raises ConfigError when a key is unknown, missing or impossible.
    """
    return vehicle_of(load_toml(path), path)


def vehicle_of(table: Mapping[str, Any], path: Path | str) -> Vehicle:
    """`load_vehicle` of a document that is already parsed; path: where it stood, for the errors."""
    only_keys(table, _MODEL_TABLES, str(path))
    if "vehicle" not in table:
        raise ConfigError(f"{path}: [vehicle] is missing; give wheel_radius and track_width in metres")
    body = as_table(table["vehicle"], f"{path}: [vehicle]")
    sizes_of = [item.name for item in fields(_Sizes)]
    only_keys(body, (*sizes_of, "antenna", "latitude_deg", "name"), f"{path}: [vehicle]")
    sizes = read_table({k: body[k] for k in body if k in sizes_of}, _Sizes, f"{path}: [vehicle]")
    for item in fields(sizes):
        above_zero(getattr(sizes, item.name), f"{path}: [vehicle] {item.name}")
    imu = as_table(table.get("imu", {}), f"{path}: [imu]")
    common = _ranges(imu, f"{path}: [imu]")
    nodes: dict[str, NodeMount] = {}
    for name, values in as_table(table.get("nodes", {}), f"{path}: [nodes]").items():
        where = f"{path}: [nodes.{name}]"
        entries = as_table(values, where)
        only_keys(entries, ("side", "facing", "steered", *RANGES, "effects"), where)
        own = common | _ranges(entries, where)
        gyro, accel = own.get("gyro_range"), own.get("accel_range")
        nodes[name] = replace(_mount(entries, where), gyro_range=gyro, accel_range=accel)
    antenna = _antenna(body, f"{path}: [vehicle] antenna")
    latitude_deg = _latitude_deg(body, f"{path}: [vehicle] latitude_deg")
    called = body.get("name", "")
    if not isinstance(called, str) or len(called) > _LONGEST_NAME:
        raise ConfigError(
            f'{path}: [vehicle] name: write a text of {_LONGEST_NAME} letters at most, as "van 7"'
        )
    topics = as_table(table.get("topics", {}), f"{path}: [topics]")
    for name, topic in topics.items():
        if not isinstance(topic, str) or not topic:
            here = f"{path}: [topics] {shown(name)} = {shown(topic)}"
            raise ConfigError(f'{here}: write a topic, such as "/imu/left"')
    return Vehicle(sizes.wheel_radius, sizes.track_width, nodes, antenna, latitude_deg, dict(topics), called)


@dataclass(frozen=True, slots=True)
class _Sizes:
    wheel_radius: float
    track_width: float


def _antenna(body: Mapping[str, Any], where: str) -> tuple[float, float] | None:
    if "antenna" not in body:
        return None
    match body["antenna"]:
        case [int() | float() as x, int() | float() as y] if abs(x) <= _FARTHEST and abs(y) <= _FARTHEST:
            return float(x), float(y)
    raise ConfigError(f"{where}: give [forward, left] in metres, such as [0.5, 0.0]")


def _latitude_deg(body: Mapping[str, Any], where: str) -> float | None:
    match body.get("latitude_deg"):
        case None:
            return None
        case bool():
            pass
        case int() | float() as value if abs(value) <= 90.0:
            return float(value)
    raise ConfigError(f"{where}: give degrees north, from -90 to 90")


def _ranges(table: Mapping[str, Any], where: str) -> dict[str, float]:
    found = {}
    for key in RANGES:
        if key in table:
            value = table[key]
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ConfigError(f"{where} {key} = {shown(value)}: give a number in rad/s or m/s²")
            found[key] = float(value)
            above_zero(found[key], f"{where} {key}")
    return found


def _mount(table: Mapping[str, Any], where: str) -> NodeMount:
    mount = read_table(
        {key: table[key] for key in ("side", "facing", "steered") if key in table}, NodeMount, where
    )
    if (mount.side is None) != (mount.facing is None):
        missing = "side" if mount.side is None else "facing"
        raise ConfigError(f"{where}: {missing} is missing; a node on a wheel has both side and facing")
    return mount
