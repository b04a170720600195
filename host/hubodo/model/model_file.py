"""The model, vehicle, noise, inputs and effects, and how it is read from TOML. Unknown keys are errors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hubodo.effects import EFFECTS, Effect, Noise, effect_of, sort_effects
from hubodo.effects.base import Level
from hubodo.errors import ConfigError
from hubodo.model.effect_tables import check_value, read_effect_tables
from hubodo.spelling import suggest_spelling
from hubodo.toml_file import (
    MAX_TOML_NUMBER,
    as_table,
    check_known_keys,
    check_positive,
    load_toml,
    read_table,
    toml_key,
)
from hubodo.vehicle import RANGE_KEYS, NodeMount, Vehicle, parse_vehicle

_EFFECT_ORDER = {effect.name: place for place, effect in enumerate(EFFECTS)}
_GYRO_CHANNELS = ("gx", "gy", "gz")
_SIGMA_KEYS = ("speed_noise", "yaw_rate_noise", "clock_sigma")


@dataclass(frozen=True, slots=True)
class ScopedEffect:
    """An effect and the node it belongs to; None for an effect of the vehicle or of all nodes."""

    effect: Effect
    node: str | None = None


@dataclass(frozen=True, slots=True)
class InputSources:
    """Sources of the inputs of a model.

    Attributes
    ----------
    speed, yaw_rate : name of a channel (see `split_input`), or a constant in m/s and rad/s.
    speed_noise, yaw_rate_noise : m/s and rad/s, 1σ noise of one sample of the inputs; 0 for exact inputs.
    clock_sigma : s, 1σ of the offset between the clock of each node and that of the inputs; 0 for one clock.
    """

    speed: str | float = "reference.speed"
    yaw_rate: str | float = "reference.yaw_rate"
    speed_noise: float = 0.0
    yaw_rate_noise: float = 0.0
    clock_sigma: float = 0.0


@dataclass(frozen=True)
class Model:
    """The content of a model file.

    Attributes
    ----------
    vehicle : Vehicle
        Geometry and nodes.
    noise : Noise
        White noise of gyros and accelerometers, 1σ per sample.
    inputs : InputSources
        Sources of speed and yaw rate, with their noise.
    effects : tuple of ScopedEffect
        Effects of all nodes first, then by node, each in the order of `EFFECTS`.

    Raises
    ------
    ValueError
        If an effect of the vehicle is assigned to a node, or an effect is duplicate.
    """

    vehicle: Vehicle
    noise: Noise
    inputs: InputSources = InputSources()
    effects: tuple[ScopedEffect, ...] = ()

    def __post_init__(self) -> None:
        nodes = [None, *self.vehicle.nodes]
        keys = [(item.node, item.effect.name) for item in self.effects]
        for node, name in keys:
            if node not in nodes:
                raise ValueError(f"{name}: the vehicle has no node {node!r}")
            if node is not None and effect_of(name).level == "vehicle":
                raise ValueError(f"{name} belongs to the vehicle, not to {node!r}")
        if len(set(keys)) < len(keys):
            raise ValueError(f"duplicate effect: {keys}")
        ordered = sorted(
            self.effects, key=lambda it: (nodes.index(it.node), _effect_rank(it.effect.name), it.effect.name)
        )
        object.__setattr__(self, "effects", tuple(ordered))

    def effects_of(self, node: str) -> tuple[Effect, ...]:
        """Return the effects of one node, in the order of `EFFECTS`.

        An effect of the node replaces one of all nodes with the same name. A node that is on no wheel has no
        effects of wheels.

        Parameters
        ----------
        node : str
            Name of the node.

        Returns
        -------
        tuple of Effect
            The effects.

        Raises
        ------
        KeyError
            If the node is unknown.
        """
        on_wheel = self.vehicle.nodes[node].side is not None
        effects = {item.effect.name: item.effect for item in self.effects if item.node is None}
        effects |= {item.effect.name: item.effect for item in self.effects if item.node == node}
        ordered = sort_effects(effects.values())
        return tuple(effect for effect in ordered if on_wheel or effect.level != "wheel")

    def with_effects(self, *added: ScopedEffect) -> Model:
        """Return the model with effects added; each replaces the effect of that name on the same node.

        Parameters
        ----------
        added : ScopedEffect
            The effects.

        Returns
        -------
        Model
            The extended copy.
        """
        keys = {(item.node, item.effect.name) for item in added}
        others = [item for item in self.effects if (item.node, item.effect.name) not in keys]
        return replace(self, effects=(*others, *added))


def _effect_rank(name: str) -> int:
    return _EFFECT_ORDER.get(name, len(_EFFECT_ORDER))


def split_input(name: str) -> tuple[str, str]:
    """Split an input into ("reference", column), (node, channel), or ("nodes", "") for both wheels."""
    if name == "nodes":
        return name, ""
    source, _, channel = name.removeprefix("nodes.").rpartition(".")
    return source, channel


def read_model(path: Path) -> Model:
    """Read a model file; `[vehicle]` and `[imu]` are required.

    Raise ConfigError, with file, table, key and the nearest known word, for unknown tables, keys, effects,
    parameters or inputs, for missing, infinite or invalid numbers, and for an effect at the wrong level.
    """
    table = load_toml(path)
    vehicle = parse_vehicle(table, path)
    return Model(
        vehicle,
        _read_noise(table, path),
        _read_inputs(table, path, vehicle),
        tuple(_read_all_effects(table, path, vehicle)),
    )


@dataclass(frozen=True, slots=True)
class _Imu:
    """Noise in table `[imu]`: 1σ of one sample, in rad/s and m/s²."""

    gyro_noise: float
    accel_noise: float


def _read_noise(table: Mapping[str, Any], path: Path) -> Noise:
    if "imu" not in table:
        raise ConfigError(
            f"{path}: [imu] is missing; give gyro_noise (rad/s) and accel_noise (m/s²), 1 sigma"
        )
    # The ranges belong to the nodes: see `parse_vehicle`.
    entries = {
        key: value for key, value in as_table(table["imu"], f"{path}: [imu]").items() if key not in RANGE_KEYS
    }
    imu = read_table(entries, _Imu, f"{path}: [imu]")
    for key in ("gyro_noise", "accel_noise"):
        check_positive(getattr(imu, key), f"{path}: [imu] {key}")
    return Noise(imu.gyro_noise, imu.accel_noise)


def _read_inputs(table: Mapping[str, Any], path: Path, vehicle: Vehicle) -> InputSources:
    where = f"{path}: [inputs]"
    entries = as_table(table.get("inputs", {}), where)
    check_known_keys(entries, ("speed", "yaw_rate", *_SIGMA_KEYS), where)
    inputs = read_table(entries, InputSources, where)
    for key in _SIGMA_KEYS:
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
    known += [f"nodes.{node}.{rate}" for node in vehicle.nodes for rate in _GYRO_CHANNELS]
    source, channel = split_input(value)
    # A node that the model lacks may still be in the log, so only the channel is checked here.
    unlisted = source not in ("", "reference", "nodes", *vehicle.nodes) and channel in _GYRO_CHANNELS
    if value in known or (source in vehicle.nodes and channel in _GYRO_CHANNELS):
        return
    if not unlisted or suggest_spelling(source, ["reference", *vehicle.nodes]):
        raise ConfigError(
            f"{where} = {value!r}: no such input{suggest_spelling(value, known)}; "
            "write a number, reference.speed, reference.yaw_rate, nodes, or nodes.NAME.gz"
        )


def _read_all_effects(table: Mapping[str, Any], path: Path, vehicle: Vehicle) -> Iterator[ScopedEffect]:
    yield from (ScopedEffect(effect) for effect in _read_effects(table, f"{path}: [effects", None))
    for name, mount in vehicle.nodes.items():
        where = f"{path}: [nodes.{toml_key(name)}.effects"
        yield from (
            ScopedEffect(effect, name) for effect in _read_effects(table["nodes"][name], where, mount)
        )


def _read_effects(table: Mapping[str, Any], where: str, mount: NodeMount | None) -> Iterator[Effect]:
    """Yield the effects of a table.

    mount: mounting of the node that owns the effects, None for effects of all nodes.
    """
    refused: dict[Level, str] = {}
    if mount is not None:
        refused["vehicle"] = "this is an effect of the vehicle; move it to [effects.{name}]"
    if mount is not None and mount.side is None:
        refused["wheel"] = "this is an effect of a wheel and the node is on none; remove it"
    for kind, values, here in read_effect_tables(table, where, refused):
        yield _read_effect(kind, values, here)


def _read_effect(kind: type[Effect], values: Mapping[str, Any], where: str) -> Effect:
    if not values:
        raise ConfigError(f"{where}: empty; give {', '.join(kind.parameters())}, or remove the table")
    effect = read_table(values, kind, where)
    for key, value in effect.values().items():
        if key not in values and kind.invalid_reason(key, value):
            raise ConfigError(f"{where}: {key} is missing; add it, in {kind.unit(key)}")
        check_value(kind, key, value, f"{where} {key}")
    return effect
