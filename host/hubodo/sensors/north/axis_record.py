"""Record of one gyro axis on a turntable: corrected for tilt, with angles from the table or the gyro."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.recording import NODE_COLUMNS, Table
from hubodo.sensors.north.motion_from_gyro import find_table_motion
from hubodo.sensors.north.mount import (
    AxisMount,
    check_turn_direction,
    confirm_turn_sense,
    describe_table_tilt,
    estimate_mount,
    vertical_earth_rate,
)
from hubodo.sensors.north.stops import TableMotion

SPIKE_RATIO = 20.0


_MIN_RECORD_SAMPLES = 100


@dataclass(frozen=True)
class AxisRecord:
    """The record of one gyro axis on a turntable.

    Attributes:
        t, rate: (N,) s and rad/s.
        table: motion of the table.
        mounting_angle: angle of the axis, anticlockwise from table zero, at table angle zero, rad.
        level_share: fraction of the horizontal Earth rate that the axis measures.
        vertical_rate: (N,) rate about the vertical, rad/s, to check the stops.
        temperature: (N,) °C, or None.
    """

    t: Array
    rate: Array
    table: TableMotion
    mounting_angle: float = 0.0
    level_share: float = 1.0
    vertical_rate: Array | None = None
    temperature: Array | None = None


@dataclass(frozen=True)
class GyroAngleOptions:
    """Options for deriving angles from the gyro, see `find_table_motion`; step: rad, max_rate: rad/s."""

    scale_sigma: float
    step: float | None = None
    max_rate: float = np.inf


def axis_mount(node: Table, axis: str) -> AxisMount:
    """Return the attitude of the axis on the table; raise InputError as in `estimate_mount`."""
    return estimate_mount(node.gyro, node.accel, axis)


def build_axis_record(
    node: Table, axis: str, table: Table | None, latitude: float, angle_options: GyroAngleOptions
) -> tuple[AxisRecord, list[str]]:
    """Return the record of an axis, and remarks for the user.

    node: calibrated samples. table: `table.csv`, or None to derive the stops from the gyro. latitude: rad.
    angle_options: options for deriving the stops. Raises InputError for too few samples, and as in
    `find_table_motion`, `estimate_mount` and `check_turn_direction`.
    """
    if len(node) < _MIN_RECORD_SAMPLES:
        raise InputError(f"{len(node)} samples are too few to find north; record several stops of the table")
    node, dropped = _complete_rows(node, axis, needs_all=table is None)
    node, spikes = _replace_spikes(node)
    mount = axis_mount(node, axis)
    warnings = list(mount.warnings)
    if dropped:
        warnings.append(f"{dropped} rows with values that are not numbers are left out")
    if spikes:
        warnings.append(f"{spikes} outliers of the gyro are replaced by the median of their neighbours")
    if table is None:
        motion = find_table_motion(
            node.t,
            node.gyro,
            mount.up,
            scale_sigma=angle_options.scale_sigma,
            step=angle_options.step,
            max_rate=angle_options.max_rate,
        )
        warnings.append("stops and angles are derived from the gyro: table zero is the first stop")
        if not confirm_turn_sense(mount, node.t, node.accel, motion):
            warnings.append(
                "nothing confirms the signs of the gyro's axes, as gravity does not turn on a level table: a "
                "reversed axis would change the azimuth unnoticed; hubodo calibrate imu checks them"
            )
    else:
        motion = TableMotion(table.t, table["angle"], table["moving"] > 0.5)
        check_turn_direction(mount, node.t, motion)
    warnings += describe_table_tilt(mount, node.t, motion)
    rate = node["g" + axis] - vertical_earth_rate(mount, latitude)
    return AxisRecord(
        node.t,
        rate,
        motion,
        mount.mounting_angle,
        mount.level_share,
        mount.vertical_rate,
        fill_temperature(node),
    ), warnings


def fill_temperature(node: Table) -> Array | None:
    """Return the temperature of each sample, °C, interpolated where it is unknown; None without a reading."""
    values = node.columns.get("temperature")
    known = np.zeros(0, bool) if values is None else np.isfinite(values)
    if values is None or not known.any():
        return None
    return np.asarray(np.interp(node.t, node.t[known], values[known]))


def _complete_rows(node: Table, axis: str, *, needs_all: bool) -> tuple[Table, int]:
    """Return the rows in which all measured channels are numbers, and how many were left out.

    needs_all: True if angles are derived from all three gyro axes. Raises InputError if a required one was
    not measured.
    """
    measured = [name for name in NODE_COLUMNS[1:] if np.isfinite(node[name]).any()]
    for name in ("gx", "gy", "gz") if needs_all else (f"g{axis}",):
        if name not in measured:
            advice = (
                "provide table.csv with the angles of the table" if needs_all else "choose another --axis"
            )
            raise InputError(f"the node has no {name}; {advice}")
    complete = np.isfinite(np.column_stack([node[name] for name in measured])).all(axis=1)
    if complete.all():
        return node, 0
    columns = {name: values[complete] for name, values in node.columns.items()}
    rows = Table(columns, None if node.t_ns is None else node.t_ns[complete])
    return rows, int(np.count_nonzero(~complete))


def _replace_spikes(node: Table) -> tuple[Table, int]:
    """Return the node with isolated gyro spikes replaced by the median of their neighbours, and their number.

    The deviation of a spike from the median of five samples exceeds SPIKE_RATIO times the usual deviation,
    and those of its neighbours do not.
    """
    columns, count = dict(node.columns), 0
    if len(node) < 5:
        return node, 0
    for name in ("gx", "gy", "gz"):
        values = node[name]
        medians = np.median(sliding_window_view(np.pad(values, 2, mode="edge"), 5), axis=1)
        deviation = np.abs(values - medians)
        typical = float(np.median(deviation[deviation > 0])) if (deviation > 0).any() else 0.0
        is_spike = deviation > SPIKE_RATIO * typical
        is_spike &= ~(np.append(is_spike[1:], False) | np.append(False, is_spike[:-1]))
        if typical and is_spike.any():
            columns[name] = np.where(is_spike, medians, values)
            count += int(np.count_nonzero(is_spike))
    return (Table(columns, node.t_ns), count) if count else (node, 0)
