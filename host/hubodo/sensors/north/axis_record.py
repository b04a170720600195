"""One gyro axis of a node on a table, ready for the likelihood: levelled, its angles known or found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.recording import Table
from hubodo.sensors.north.find_stops import find_motion
from hubodo.sensors.north.mount import Mount, check_direction, mount_of, tilt_warning, vertical_earth
from hubodo.sensors.north.stops import TableMotion

SPIKE = 20.0


_LEAST = 100
"""Samples; fewer are no stop."""


@dataclass(frozen=True)
class AxisRecord:
    """What one axis felt.

    t: (N,) s. rate: (N,) rad/s. mounting: rad, the axis anticlockwise from table zero at table angle zero.
    level: share of level Earth rate that it feels. vertical: (N,) rad/s upwards, proves that stops were
    stops.
    """

    t: Array
    rate: Array
    table: TableMotion
    mounting: float = 0.0
    level: float = 1.0
    vertical: Array | None = None


@dataclass(frozen=True)
class FoundAngles:
    """How angles are taken from the gyro itself; see `find_motion`. step: rad. limit: rad/s."""

    scale_sigma: float
    step: float | None = None
    limit: float = np.inf


def mounted(node: Table, axis: str) -> Mount:
    """How the axis sits on the table. Raises InputError as of `mount_of`."""
    return mount_of(node.gyro, node.accel, axis)


def axis_record(
    node: Table, axis: str, table: Table | None, latitude: float, found: FoundAngles
) -> tuple[AxisRecord, list[str]]:
    """The record of an axis, and what must be said of it.

    node: samples with the calibration applied. table: `table.csv`, or None to find the stops. latitude: rad.
    Raises InputError for a record of nothing, and as of `find_motion`, `mount_of` and `check_direction`.
    """
    if len(node) < _LEAST:
        raise InputError(f"{len(node)} samples are too few to find north; record some stops of the table")
    node, spikes = _without_spikes(node)
    mount = mounted(node, axis)
    warnings = list(mount.warnings)
    if spikes:
        warnings.append(f"{spikes} single samples of the gyro stand out by far and are left out")
    if table is None:
        motion = find_motion(
            node.t, node.gyro, mount.up, scale_sigma=found.scale_sigma, step=found.step, limit=found.limit
        )
        warnings.append("stops and angles are the gyro's: table zero is where the table stood first")
    else:
        motion = TableMotion(table.t, table["angle"], table["moving"] > 0.5)
        check_direction(mount, node.t, motion)
    warnings += tilt_warning(mount, node.t, motion)
    rate = node["g" + axis] - vertical_earth(mount, latitude)
    return AxisRecord(node.t, rate, motion, mount.mounting, mount.level, mount.vertical), warnings


def _without_spikes(node: Table) -> tuple[Table, int]:
    """The node with single samples of its gyro that no motion makes replaced by what is around them.

    A spike is further from the median of the five about it than SPIKE times what samples usually are, while
    its neighbours are not.
    """
    columns, count = dict(node.columns), 0
    if len(node) < 5:
        return node, 0
    for name in ("gx", "gy", "gz"):
        values = node[name]
        around = np.median(sliding_window_view(np.pad(values, 2, mode="edge"), 5), axis=1)
        off = np.abs(values - around)
        usual = float(np.median(off[off > 0])) if (off > 0).any() else 0.0
        odd = off > SPIKE * usual
        odd &= ~(np.append(odd[1:], False) | np.append(False, odd[:-1]))
        if usual and odd.any():
            columns[name] = np.where(odd, around, values)
            count += int(np.count_nonzero(odd))
    return (Table(columns, node.t_ns), count) if count else (node, 0)
