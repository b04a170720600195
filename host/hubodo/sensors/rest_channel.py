"""One channel of a node at rest, checked before anything is made of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.file import find_node_serial
from hubodo.errors import InputError
from hubodo.log.number_recording import IMU_CHANNELS as IMU_CHANNELS
from hubodo.recording import Recording, Table
from hubodo.sensors.at_rest import TemperatureStep, check_still, check_units, rest_of, temperature_step

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Standstill:
    """One channel at rest.

    t: (N,) s; values: (N,) rad/s or m/s²; temperature: (N,) degrees C or None; step: a temperature step, or
    None; serial: of the node, "" when the log does not tell; warnings: of the log; disturbed: (from, to) in
    s of what is to be cut out, where the user of it can do without it.
    """

    node: str
    channel: str
    t: FloatArray
    values: FloatArray
    temperature: FloatArray | None
    step: TemperatureStep | None
    serial: str
    warnings: tuple[str, ...]
    disturbed: tuple[tuple[float, float], ...] = ()


def rest_channel(
    recording: Recording,
    node: str,
    channel: str,
    *,
    log: str,
    start: float | None = None,
    end: float | None = None,
    trust_units: bool = False,
    trust_still: bool = False,
    cut: bool = False,
) -> Standstill:
    """A channel of a node between two times of the log, s, checked for units and movement.

    cut: movement is no error but told in `disturbed`. Raises InputError: no such channel, nothing in the
    span, wrong unit, moved.
    """
    table = recording.nodes[node]
    bounds = -np.inf if start is None else start, np.inf if end is None else end
    span = slice(*np.searchsorted(table.t, bounds))
    measured = [name for name in IMU_CHANNELS if np.isfinite(table[name][span]).any()]
    if channel not in measured:
        raise InputError(
            f"{log}: node {node} has no {channel}; say --channel with {', '.join(measured) or 'another'}"
        )
    columns = np.column_stack([table[name][span] for name in measured])
    finite = np.isfinite(columns).all(axis=1)
    t, columns = table.t[span][finite], columns[finite]
    if len(t) < 2:
        raise InputError(
            f"{log}: node {node} has {len(t)} samples between --start and --end; choose another span"
        )
    gyro = columns[:, [k for k, name in enumerate(measured) if name[0] == "g"]]
    accel = columns[:, [k for k, name in enumerate(measured) if name[0] == "a"]]
    values = columns[:, measured.index(channel)].copy()
    moved: list[tuple[float, float]] = []
    try:
        if not trust_units:
            check_units(gyro, accel, float(np.median(np.diff(t))))
        if not trust_still and cut:
            moved = rest_of(t, columns, values)
        elif not trust_still:
            check_still(t, columns)
    except InputError as error:
        raise InputError(f"{log}, node {node}: {error}") from None
    temperature = temperature_of(table, np.flatnonzero(finite) + span.start)
    step = None if temperature is None else temperature_step(t, temperature)
    serial = find_node_serial(recording.metadata, node)
    return Standstill(node, channel, t, values, temperature, step, serial, recording.warnings, tuple(moved))


def temperature_of(table: Table, rows: NDArray[np.int64]) -> FloatArray | None:
    """(M,) degrees C of these rows, interpolated where a reading is missing; None without any."""
    if "temperature" not in table:
        return None
    values = table["temperature"][rows]
    known = np.isfinite(values)
    if not known.any():
        return None
    places = np.arange(len(values))
    made: FloatArray = np.interp(places, places[known], values[known])
    return made
