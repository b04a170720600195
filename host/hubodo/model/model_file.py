"""The model file: vehicle, noise, inputs and effects in TOML, read with every key accounted for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hubodo.atomic_files import write_atomically
from hubodo.effects import EFFECTS, Effect, Noise, effect_of, in_order
from hubodo.effects.base import Level
from hubodo.errors import ConfigError
from hubodo.model.effect_tables import check_value, effect_heading, effect_tables
from hubodo.toml_file import (
    MAX_TOML_NUMBER,
    as_table,
    check_known_keys,
    check_positive,
    load_toml,
    read_table,
    suggest_spelling,
    toml_key,
    toml_number,
    toml_text,
)
from hubodo.vehicle import RANGE_KEYS, NodeMount, Vehicle, parse_vehicle

_ORDER = {effect.name: place for place, effect in enumerate(EFFECTS)}
_RATES = ("gx", "gy", "gz")
_SPREADS = ("speed_noise", "yaw_rate_noise", "clock_sigma")


@dataclass(frozen=True, slots=True)
class Scoped:
    """An effect and whose it is: the node's of that name, or with None the vehicle's or every node's."""

    effect: Effect
    node: str | None = None


@dataclass(frozen=True, slots=True)
class InputNames:
    """What drives the model: channels by name (see `split_input`), or constants in m/s and rad/s.

    speed_noise m/s, yaw_rate_noise rad/s: 1 sigma of one sample of the inputs themselves; without them in the
    file the inputs count as exact. clock_sigma: s, 1 sigma of how well the stamps of each node and those of
    the inputs agree; 0 for one common clock.
    """

    speed: str | float = "reference.speed"
    yaw_rate: str | float = "reference.yaw_rate"
    speed_noise: float = 0.0
    yaw_rate_noise: float = 0.0
    clock_sigma: float = 0.0


@dataclass(frozen=True)
class Model:
    """What a model file says. effects: sorted, those without a node first, then in the order of EFFECTS.

    Raises ValueError for an effect of the vehicle under a node, or two of a name in one place.
    """

    vehicle: Vehicle
    noise: Noise
    inputs: InputNames = InputNames()
    effects: tuple[Scoped, ...] = ()

    def __post_init__(self) -> None:
        nodes = [None, *self.vehicle.nodes]
        places = [(item.node, item.effect.name) for item in self.effects]
        for node, name in places:
            if node not in nodes:
                raise ValueError(f"{name}: the vehicle has no node {node!r}")
            if node is not None and effect_of(name).level == "vehicle":
                raise ValueError(f"{name} belongs to the vehicle, not to {node!r}")
        if len(set(places)) < len(places):
            raise ValueError(f"an effect stands twice in one place: {places}")
        ordered = sorted(
            self.effects, key=lambda it: (nodes.index(it.node), _place(it.effect.name), it.effect.name)
        )
        object.__setattr__(self, "effects", tuple(ordered))

    def effects_of(self, node: str) -> tuple[Effect, ...]:
        """The effects of one node in the order of EFFECTS; its own goes before one for all of that name.

        A node that sits on no wheel has no effects of wheels. KeyError for a node that is not there.
        """
        on_wheel = self.vehicle.nodes[node].side is not None
        found = {item.effect.name: item.effect for item in self.effects if item.node is None}
        found |= {item.effect.name: item.effect for item in self.effects if item.node == node}
        kept = in_order(found.values())
        return tuple(effect for effect in kept if on_wheel or effect.level != "wheel")

    def with_effects(self, *added: Scoped) -> Model:
        """The same with these effects; each replaces the one of its name in the same place."""
        places = {(item.node, item.effect.name) for item in added}
        kept = [item for item in self.effects if (item.node, item.effect.name) not in places]
        return replace(self, effects=(*kept, *added))


def _place(name: str) -> int:
    return _ORDER.get(name, len(_ORDER))


def split_input(name: str) -> tuple[str, str]:
    """("reference", column), (node, channel), or ("nodes", "") for both wheels together."""
    if name == "nodes":
        return name, ""
    source, _, channel = name.removeprefix("nodes.").rpartition(".")
    return source, channel


def read_model(path: Path) -> Model:
    """Read a model file; `[vehicle]` and `[imu]` are required.

    Raises ConfigError with file, table, key and the nearest known word: unknown tables, keys, effects,
    parameters or inputs; missing, infinite or impossible numbers; an effect where it cannot be.
    """
    table = load_toml(path)
    vehicle = parse_vehicle(table, path)
    return Model(
        vehicle, _noise(table, path), _inputs(table, path, vehicle), tuple(_all(table, path, vehicle))
    )


@dataclass(frozen=True, slots=True)
class _Imu:
    gyro_noise: float
    accel_noise: float


def _noise(table: Mapping[str, Any], path: Path) -> Noise:
    if "imu" not in table:
        raise ConfigError(
            f"{path}: [imu] is missing; give gyro_noise (rad/s) and accel_noise (m/s²), 1 sigma"
        )
    # The ranges are the nodes': see `parse_vehicle`.
    entries = {
        key: value for key, value in as_table(table["imu"], f"{path}: [imu]").items() if key not in RANGE_KEYS
    }
    imu = read_table(entries, _Imu, f"{path}: [imu]")
    for key in ("gyro_noise", "accel_noise"):
        check_positive(getattr(imu, key), f"{path}: [imu] {key}")
    return Noise(imu.gyro_noise, imu.accel_noise)


def _inputs(table: Mapping[str, Any], path: Path, vehicle: Vehicle) -> InputNames:
    where = f"{path}: [inputs]"
    entries = as_table(table.get("inputs", {}), where)
    check_known_keys(entries, ("speed", "yaw_rate", *_SPREADS), where)
    inputs = read_table(entries, InputNames, where)
    for key in _SPREADS:
        if not 0.0 <= getattr(inputs, key) <= MAX_TOML_NUMBER:
            raise ConfigError(f"{where} {key} = {getattr(inputs, key)}: must be a finite number, 0 or more")
    for key in ("speed", "yaw_rate"):
        _check_input(getattr(inputs, key), f"{where} {key}", vehicle)
    return inputs


def _check_input(value: str | float, where: str, vehicle: Vehicle) -> None:
    if not isinstance(value, str):
        if not math.isfinite(value):
            raise ConfigError(f"{where} = {value}: must be a finite number or the name of a channel")
        return
    known = ["reference.speed", "reference.yaw_rate", "nodes"]
    known += [f"nodes.{node}.{rate}" for node in vehicle.nodes for rate in _RATES]
    source, channel = split_input(value)
    # A node that the vehicle does not list may still be in the log: only its channel can be checked here.
    other = source not in ("", "reference", "nodes", *vehicle.nodes) and channel in _RATES
    if value in known or (source in vehicle.nodes and channel in _RATES):
        return
    if not other or suggest_spelling(source, ["reference", *vehicle.nodes]):
        raise ConfigError(
            f"{where} = {value!r}: no such input{suggest_spelling(value, known)}; "
            "write a number, reference.speed, reference.yaw_rate, nodes, or nodes.NAME.gz"
        )


def _all(table: Mapping[str, Any], path: Path, vehicle: Vehicle) -> Iterator[Scoped]:
    yield from (Scoped(effect) for effect in _effects(table, f"{path}: [effects", None))
    for name, mount in vehicle.nodes.items():
        where = f"{path}: [nodes.{toml_key(name)}.effects"
        yield from (Scoped(effect, name) for effect in _effects(table["nodes"][name], where, mount))


def _effects(table: Mapping[str, Any], where: str, mount: NodeMount | None) -> Iterator[Effect]:
    """mount: of the node whose effects they are, None for those of all."""
    refused: dict[Level, str] = {}
    if mount is not None:
        refused["vehicle"] = "this is an effect of the vehicle; move it to [effects.{name}]"
    if mount is not None and mount.side is None:
        refused["wheel"] = "this is an effect of a wheel and the node is on none; remove it"
    for kind, values, here in effect_tables(table, where, refused):
        yield _effect(kind, values, here)


def _effect(kind: type[Effect], values: Mapping[str, Any], where: str) -> Effect:
    if not values:
        raise ConfigError(f"{where}: empty; give {', '.join(kind.parameters())}, or remove the table")
    effect = read_table(values, kind, where)
    for key, value in effect.values().items():
        if key not in values and kind.problem(key, value):
            raise ConfigError(f"{where}: {key} is missing; add it, in {kind.unit(key)}")
        check_value(kind, key, value, f"{where} {key}")
    return effect


def write_model(
    model: Model, path: Path, comments: Mapping[tuple[str, str | None], str] | None = None
) -> None:
    """Write a model so that it reads back equal; an existing file is replaced.

    comments: text above an effect, by (name, node or None). Raises InputError without the folder, ValueError
    for an effect with a value that `read_model` would refuse.
    """
    write_atomically(path, model_toml(model, comments))


def model_toml(model: Model, comments: Mapping[tuple[str, str | None], str] | None = None) -> str:
    """The text of the file that `write_model` writes."""
    noise, inputs, vehicle = model.noise, model.inputs, model.vehicle
    lines = [
        "[vehicle]",
        *([f"name = {toml_text(vehicle.name)}"] if vehicle.name else []),
        _number("wheel_radius", vehicle.wheel_radius, "m"),
        _number("track_width", vehicle.track_width, "m, between contacts"),
        *_antenna(vehicle),
        "",
        "[imu]",
        _number("gyro_noise", noise.gyro, "rad/s, 1 sigma per sample"),
        _number("accel_noise", noise.accel, "m/s², 1 sigma per sample"),
        "",
        "[inputs]",
        _input("speed", inputs.speed, "m/s"),
        _input("yaw_rate", inputs.yaw_rate, "rad/s"),
        _number("speed_noise", inputs.speed_noise, "m/s, 1 sigma per sample"),
        _number("yaw_rate_noise", inputs.yaw_rate_noise, "rad/s, 1 sigma per sample"),
    ]
    if inputs.clock_sigma > 0.0:
        lines.append(_number("clock_sigma", inputs.clock_sigma, "s, between the nodes and the inputs"))
    for name, mount in vehicle.nodes.items():
        lines += ["", f"[nodes.{toml_key(name)}]"]
        if mount.side is not None:
            lines += [f'side = "{mount.side}"', f'facing = "{mount.facing}"']
        for key, value, unit in zip(
            RANGE_KEYS, (mount.gyro_range, mount.accel_range), ("rad/s", "m/s²"), strict=True
        ):
            if value is not None:
                lines.append(_number(key, value, f"{unit}, where its samples end"))
    if vehicle.topics:
        lines += ["", "[topics]"]
        lines += [f"{toml_key(name)} = {toml_text(topic)}" for name, topic in vehicle.topics.items()]
    for item in model.effects:
        prefix = "effects" if item.node is None else f"nodes.{toml_key(item.node)}.effects"
        comment = (comments or {}).get((item.effect.name, item.node), "")
        # TOML allows no control characters in a comment.
        plain = ("".join(c if c.isprintable() else " " for c in line) for line in comment.splitlines())
        lines += ["", *(f"# {line}" for line in plain)]
        lines.append(effect_heading(prefix, item.effect.name))
        for key, value in item.effect.values().items():
            says = item.effect.problem(key, value)
            if says:
                raise ValueError(f"{item.effect.name} {key} = {value}: {says}")
            if value or key in item.effect.fitted():
                lines.append(_number(key, value, item.effect.unit(key)))
    return "\n".join(lines) + "\n"


def _antenna(vehicle: Vehicle) -> list[str]:
    if vehicle.antenna is None:
        return []
    forward, left = map(toml_number, vehicle.antenna)
    return [f"antenna = [{forward}, {left}]  # m, forward and left of midway between the wheels"]


def _number(key: str, value: float, unit: str) -> str:
    return f"{f'{key} = {toml_number(value)}':<40} # {unit}"


def _input(key: str, value: str | float, unit: str) -> str:
    return f"{key} = {toml_text(value)}" if isinstance(value, str) else _number(key, value, unit)
