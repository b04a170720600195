"""Read a table of pose means: one row for each static pose, with its noise and reference where known."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.column_names import is_node_header, parse_heading
from hubodo.log.number_file import NumberTable, detect_file_kind, read_numbers
from hubodo.log.number_recording import IMU_CHANNELS, InputFormat, recording_from_numbers

_PREFIXED = re.compile(r"(sigma|std|ref)_(.+)")
_COUNT_NAMES = ("count", "n", "samples")


@dataclass(frozen=True)
class PoseTable:
    """Means of R static poses in the order of IMU_CHANNELS, in SI units; NaN where a column is missing.

    Attributes:
        mean: (R, 6) gx to gz and ax to az.
        sigma: (R, 6) standard errors of the means.
        std: (R, 6) standard deviations of the samples.
        reference: (R, 6) true values.
        count: (R,) samples in each mean.
    """

    mean: Array
    sigma: Array
    std: Array
    reference: Array
    count: Array


def read_pose_table(path: Path, input_format: InputFormat) -> PoseTable:
    """Read a number file with columns such as `ax`, `sigma_ax`, `std_ax`, `ref_ax` and `count`.

    Units are those of the headings, else of `input_format`; columns without either are in SI units, as in the
    CSV file of a node. Other columns, such as labels, are ignored. Raises InputError if the file has no means
    or a unit is missing.
    """
    numbers = read_numbers(path, detect_file_kind(path), input_format.variable)
    return pose_table_from_numbers(str(path), numbers, input_format)


def pose_table_from_numbers(source: str, numbers: NumberTable, input_format: InputFormat) -> PoseTable:
    """Return the pose means of a table of numbers, as `read_pose_table` does; source: name for errors."""
    names = input_format.columns or numbers.names
    if len(names) != numbers.values.shape[1]:
        stated = "names " + str(len(names)) if names else "is needed"
        raise InputError(
            f"{source}: has {numbers.values.shape[1]} columns, --columns {stated}; name each, such as "
            "ax,ay,az,sigma_ax,sigma_ay,sigma_az,ref_az,count; - omits one"
        )
    parts: dict[str, dict[str, Array]] = {"mean": {}, "sigma": {}, "std": {}, "ref": {}}
    count = np.full(len(numbers.values), np.nan)
    for name, values in zip(names, numbers.values.T, strict=True):
        match = _PREFIXED.fullmatch(name.strip().lower())
        kind, channel = (match[1], name.strip()[len(match[1]) + 1 :]) if match else ("mean", name)
        if name.strip().lower() in _COUNT_NAMES:
            count = values
        elif parse_heading(channel).name in IMU_CHANNELS:
            parts[kind][channel] = values
    if not parts["mean"]:
        raise InputError(f"{source}: has no column of means, such as ax; name them with --columns")
    units = {parse_heading(name).name: parse_heading(name).unit for name in parts["mean"]}
    arrays = {kind: _si_values(source, kind, columns, units, input_format) for kind, columns in parts.items()}
    mean = arrays["mean"]
    if not np.isfinite(mean[:, np.isfinite(mean).any(axis=0)]).all():
        row = int(np.argmin(np.isfinite(mean[:, np.isfinite(mean).any(axis=0)]).all(axis=1)))
        raise InputError(f"{source}: pose {row + 1} lacks a mean; complete or remove its row")
    return PoseTable(mean, arrays["sigma"], arrays["std"], arrays["ref"], count)


def _si_values(
    source: str, kind: str, columns: dict[str, Array], units: dict[str, str], input_format: InputFormat
) -> Array:
    """Return the (R, 6) values of columns of one kind; without a unit they have that of the mean."""
    if not columns:
        return np.full((1, len(IMU_CHANNELS)), np.nan)
    names = []
    for name in columns:
        column = parse_heading(name)
        unit = column.unit or units.get(column.name, "")
        names.append(f"{column.name} ({unit})" if unit else column.name)
    form = replace(input_format, rate=1.0, columns=())
    if kind in ("sigma", "std"):
        form = replace(form, zeros={})
    elif kind == "ref":
        plain = tuple(unit.replace("*", " ").split(" ")[-1] for unit in form.units)
        form = replace(form, zeros={}, scales={}, units=plain)
    table = NumberTable(np.column_stack(list(columns.values())), tuple(names), {})
    is_si = is_node_header(tuple(parse_heading(name).name for name in names))
    node = recording_from_numbers(source, "poses", table, form, is_si=is_si).nodes["poses"]
    values = np.column_stack([node[name] for name in IMU_CHANNELS])
    return np.abs(values) if kind in ("sigma", "std") else values
