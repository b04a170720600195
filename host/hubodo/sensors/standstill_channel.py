"""One channel of a stationary node, checked for units and motion before analysis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.calibration.file import find_node_serial
from hubodo.errors import InputError
from hubodo.log.number_recording import IMU_CHANNELS as IMU_CHANNELS
from hubodo.recording import Recording, Table
from hubodo.sensors.frozen_readings import check_not_frozen
from hubodo.sensors.saturation import check_saturation
from hubodo.sensors.standstill_checks import (
    TemperatureStep,
    check_standstill,
    check_units,
    find_cuts,
    find_temperature_step,
)


@dataclass(frozen=True)
class StandstillRecord:
    """One channel of a stationary node.

    Attributes:
        source: log, node and channel, for errors.
        node, channel: name of the node and of its column.
        t: (N,) s.
        values: (N,) rad/s or m/s².
        temperature: (N,) °C or None.
        temperature_step: a step of the temperature, or None.
        serial: serial number of the node, empty if the log does not contain it.
        warnings: warnings of the log.
        disturbances: (start, end) in s of the spans to be excluded.
    """

    source: str
    node: str
    channel: str
    t: Array
    values: Array
    temperature: Array | None
    temperature_step: TemperatureStep | None
    serial: str
    warnings: tuple[str, ...]
    disturbances: tuple[tuple[float, float], ...] = ()


def read_standstill_channel(
    recording: Recording,
    node: str,
    channel: str,
    *,
    log: str,
    start: float | None = None,
    end: float | None = None,
    trust_units: bool = False,
    stated_units: frozenset[str] = frozenset(),
    trust_still: bool = False,
    cut_disturbances: bool = False,
) -> StandstillRecord:
    """Return a channel of a node between two times of the log (s), checked for units and motion.

    log: name of the log for errors. stated_units: "gyro" or "accel" where the user stated the unit, which is
    then not checked. cut_disturbances: report motion in `disturbances` instead of raising an error. Raises
    InputError for an unmeasured channel, an empty span, a wrong unit or a sensor that was moved.
    """
    table = recording.nodes[node]
    span = _select_span(table, start, end, f"{log}: node {node}")
    measured = [name for name in IMU_CHANNELS if np.isfinite(table[name][span]).any()]
    if channel not in measured:
        raise InputError(
            f"{log}: node {node} has no {channel}; use --channel with {', '.join(measured) or 'another'}"
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
    try:
        if not trust_units:
            check_units(
                None if "gyro" in stated_units else gyro,
                None if "accel" in stated_units else accel,
                float(np.median(np.diff(t))),
            )
        disturbances = [] if trust_still else _check_quiet(t, columns, values, channel, cut_disturbances)
    except InputError as error:
        raise InputError(f"{log}, node {node}: {error}") from None
    temperature = interpolate_temperature(table, np.flatnonzero(finite) + span.start)
    temperature_step = None if temperature is None else find_temperature_step(t, temperature)
    serial = find_node_serial(recording.metadata, node)
    return StandstillRecord(
        f"{log}, node {node}, {channel}",
        node,
        channel,
        t,
        values,
        temperature,
        temperature_step,
        serial,
        recording.warnings,
        tuple(disturbances),
    )


def _check_quiet(
    t: Array, columns: Array, values: Array, channel: str, cut: bool
) -> list[tuple[float, float]]:
    """Return the disturbances to cut out; raise InputError for a saturated, frozen or moved sensor."""
    check_saturation(values, channel)
    if cut:
        return find_cuts(t, columns, values)
    check_not_frozen(t, values, channel)
    check_standstill(t, columns)
    return []


def _select_span(table: Table, start: float | None, end: float | None, source: str) -> slice:
    """Return the rows between two times, s; raise InputError if only other times have rows."""
    bounds = -np.inf if start is None else start, np.inf if end is None else end
    span = slice(*np.searchsorted(table.t, bounds))
    if len(table) and span.start >= span.stop:
        raise InputError(
            f"{source} has no samples between --start and --end; they are from {table.t[0]:.6g} to "
            f"{table.t[-1]:.6g} s"
        )
    return span


def interpolate_temperature(table: Table, rows: NDArray[np.int64]) -> Array | None:
    """Return the (M,) temperatures of these rows, °C, interpolated where missing.

    Returns None if there is no temperature at all.
    """
    if "temperature" not in table:
        return None
    values = table["temperature"][rows]
    known = np.isfinite(values)
    if not known.any():
        return None
    indices = np.arange(len(values))
    temperature: Array = np.interp(indices, indices[known], values[known])
    return temperature
