"""The text of a model file, which reads back to an equal model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from hubodo.atomic_files import write_atomically
from hubodo.model.effect_tables import effect_heading
from hubodo.model.model_file import Model
from hubodo.toml_file import toml_key, toml_number, toml_text
from hubodo.vehicle import RANGE_KEYS, Vehicle, has_unusual_size


def write_model(
    model: Model, path: Path, comments: Mapping[tuple[str, str | None], str] | None = None
) -> None:
    """Write a model so that it reads back equal; an existing file is replaced.

    comments: text above an effect, by (name, node or None). Raise InputError if the folder does not exist,
    and ValueError for a value that `read_model` would refuse.
    """
    write_atomically(path, model_toml(model, comments))


def model_toml(model: Model, comments: Mapping[tuple[str, str | None], str] | None = None) -> str:
    """Return the text of a model file."""
    noise, inputs, vehicle = model.noise, model.inputs, model.vehicle
    lines = [
        "[vehicle]",
        *([f"name = {toml_text(vehicle.name)}"] if vehicle.name else []),
        _number_line("wheel_radius", vehicle.wheel_radius, "m"),
        *([f'radius_from = "{vehicle.radius_from}"'] if vehicle.radius_from != "nominal" else []),
        _number_line("track_width", vehicle.track_width, "m, between contacts"),
        *(["unusual_size = true"] if has_unusual_size(vehicle) else []),
        *_antenna_lines(vehicle),
        "",
        "[imu]",
        _number_line("gyro_noise", noise.gyro, "rad/s, 1 sigma per sample"),
        _number_line("accel_noise", noise.accel, "m/s², 1 sigma per sample"),
        "",
        "[inputs]",
        _input_line("speed", inputs.speed, "m/s"),
        _input_line("yaw_rate", inputs.yaw_rate, "rad/s"),
        _number_line("speed_noise", inputs.speed_noise, "m/s, 1 sigma per sample"),
        _number_line("yaw_rate_noise", inputs.yaw_rate_noise, "rad/s, 1 sigma per sample"),
    ]
    if inputs.clock_sigma > 0.0:
        lines.append(_number_line("clock_sigma", inputs.clock_sigma, "s, between the nodes and the inputs"))
    for name, mount in vehicle.nodes.items():
        lines += ["", f"[nodes.{toml_key(name)}]"]
        if mount.side is not None:
            lines += [f'side = "{mount.side}"', f'facing = "{mount.facing}"']
        for key, value, unit in zip(
            RANGE_KEYS, (mount.gyro_range, mount.accel_range), ("rad/s", "m/s²"), strict=True
        ):
            if value is not None:
                lines.append(_number_line(key, value, f"{unit}, range of the sensor"))
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
            reason = item.effect.invalid_reason(key, value)
            if reason:
                raise ValueError(f"{item.effect.name} {key} = {value}: {reason}")
            if value or key in item.effect.fitted_parameters():
                lines.append(_number_line(key, value, item.effect.unit(key)))
    return "\n".join(lines) + "\n"


def _antenna_lines(vehicle: Vehicle) -> list[str]:
    if vehicle.antenna is None:
        return []
    forward, left = map(toml_number, vehicle.antenna)
    return [f"antenna = [{forward}, {left}]  # m, forward and left of midway between the wheels"]


def _number_line(key: str, value: float, unit: str) -> str:
    return f"{f'{key} = {toml_number(value)}':<40} # {unit}"


def _input_line(key: str, value: str | float, unit: str) -> str:
    return f"{key} = {toml_text(value)}" if isinstance(value, str) else _number_line(key, value, unit)
