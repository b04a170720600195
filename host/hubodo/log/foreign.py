"""Files of numbers that do not say what they are to a recording; nothing is guessed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.number_file import Kind, Numbers, list_names, read_numbers
from hubodo.log.roles import BY_TYPE, TopicChoice
from hubodo.log.units import si_factor
from hubodo.recording import NODE_COLUMNS, NODE_OPTIONAL_COLUMNS, Recording, Table

FloatArray = NDArray[np.float64]

CHANNELS = NODE_COLUMNS[1:]
_TIMES = {"t": 1.0, "t_ms": 1e-3, "t_us": 1e-6, "t_ns": 1e-9}
_KNOWN = (*_TIMES, *CHANNELS, *NODE_OPTIONAL_COLUMNS)


@dataclass(frozen=True)
class LogForm:
    """What the user says of a file that does not say it itself.

    rate: samples per second, where there is no time. units: in which its numbers are, of gyro and
    accelerometer. columns: what each column is, by the names of the CSV folder; "-" leaves one out.
    variable: which arrays of a MATLAB or HDF5 file. channel: what a single column is. choice: which topic is
    what.
    """

    rate: float | None = None
    units: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    variable: str | None = None
    channel: str = "gz"
    choice: TopicChoice = BY_TYPE

    def factors(self) -> dict[str, float]:
        """What makes SI of "gyro" and "accel", as far as units tell. Raises InputError for no unit."""
        return dict(si_factor(unit) for unit in self.units)


def read_number_file(path: Path, kind: Kind, form: LogForm) -> Recording:
    """One node with the columns that the file has; others are NaN.

    Raises InputError where columns, rate or unit are neither in the file nor in form.
    """
    numbers = read_numbers(path, kind, form.variable)
    names = _names(path, numbers, form)
    # Only a file whose header is that of the CSV folder is in SI units by that.
    ours = kind == "text" and not form.columns and len(names) > 1
    columns: dict[str, FloatArray] = {"t": _times(path, numbers, names, form)}
    factors = _factors(path, numbers, names, form, ours)
    for place, name in enumerate(names):
        if name in CHANNELS:
            columns[name] = numbers.values[:, place] * factors[name]
        elif name in NODE_OPTIONAL_COLUMNS:
            columns[name] = numbers.values[:, place]
    for name in CHANNELS:
        columns.setdefault(name, np.full(len(columns["t"]), np.nan))
    left_out = [label for label, name in zip(numbers.names, names, strict=False) if name not in _KNOWN]
    warnings = (f"{path}: left out: {list_names(left_out)}",) if left_out else ()
    return Recording({path.name.split(".")[0]: Table(columns)}, warnings=warnings)


def in_si(recording: Recording, form: LogForm) -> Recording:
    """A log whose gyro or accelerometer is not in SI units but in those of form."""
    factors = form.factors()
    if not factors:
        return recording
    nodes = {}
    for name, table in recording.nodes.items():
        columns = {
            column: values * factors.get("gyro" if column[0] == "g" else "accel", 1.0)
            if column in CHANNELS
            else values
            for column, values in table.columns.items()
        }
        nodes[name] = Table(columns, table.t_ns)
    return Recording(**{**vars(recording), "nodes": nodes})


def _names(path: Path, numbers: Numbers, form: LogForm) -> tuple[str, ...]:
    """What each column is."""
    width = numbers.values.shape[1]
    if form.columns:
        if len(form.columns) != width:
            raise InputError(
                f"{path}: has {width} columns, --columns names {len(form.columns)}; name each, or say -"
            )
        for name in form.columns:
            if name not in _KNOWN and name != "-":
                raise InputError(f"--columns: {name!r} is none of {', '.join(_KNOWN)}, -")
        return form.columns
    last = tuple(name.replace("/", ".").rpartition(".")[2] for name in numbers.names)
    if any(name in CHANNELS for name in last):
        return last
    if width == 1:
        return (form.channel,)
    named = f" ({list_names(numbers.names)})" if numbers.names else ""
    raise InputError(
        f"{path}: has {width} columns{named}; say with --columns what each is, as in "
        "--columns t,gx,gy,gz,ax,ay,az; - leaves one out"
    )


def _times(path: Path, numbers: Numbers, names: tuple[str, ...], form: LogForm) -> FloatArray:
    place = next((k for k, name in enumerate(names) if name in _TIMES), None)
    if place is None:
        if form.rate is None:
            raise InputError(f"{path}: tells no times; say --rate with its samples per second")
        return np.arange(len(numbers.values)) / form.rate
    if form.rate is not None:
        raise InputError(f"{path}: tells its times in column {names[place]}; leave --rate out")
    t = numbers.values[:, place] * _TIMES[names[place]]
    if not np.isfinite(t).all():
        raise InputError(f"{path}: row {int(np.argmin(np.isfinite(t))) + 1} of its numbers has no time")
    falls = np.flatnonzero(np.diff(t) <= 0.0)
    if len(falls):
        raise InputError(
            f"{path}: time does not increase at row {int(falls[0]) + 2} of its numbers; remove it"
        )
    return t


def _factors(
    path: Path, numbers: Numbers, names: tuple[str, ...], form: LogForm, ours: bool
) -> Mapping[str, float]:
    """What makes SI of each channel."""
    said = form.factors()
    made = {}
    for place, name in enumerate(names):
        if name not in CHANNELS:
            continue
        sensor = "gyro" if name[0] == "g" else "accel"
        label = numbers.names[place].partition("[")[0] if numbers.names else ""
        if sensor in said:
            made[name] = said[sensor]
        elif label in numbers.units and si_factor(numbers.units[label])[0] == sensor:
            made[name] = si_factor(numbers.units[label])[1]
        elif ours:
            made[name] = 1.0
        else:
            known = "rad/s, deg/s, mdeg/s, deg/h" if sensor == "gyro" else "m/s^2, g, mg"
            raise InputError(
                f"{path}: does not say in which unit {name} is; say --unit with one of {known}, or with "
                "what one count stands for, as in --unit '0.00875 deg/s'"
            )
    return made
