"""How a node sits on a turntable, from gravity: which way is up, what is level, which way it turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE
from hubodo.errors import InputError
from hubodo.sensors.north.stops import TableMotion

MAX_ELEVATION = np.radians(30)
WARN_ELEVATION = np.radians(2)
MIN_TURN = np.radians(60)


@dataclass(frozen=True)
class Mount:
    """How one axis of a node sits on the table.

    up: (3,) unit vector in node axes. mounting: rad, the axis anticlockwise from table zero at table angle
    zero. level: cosine of the axis's elevation, the share of level Earth rate that it feels. vertical: (N,)
    rad/s upwards. lean: (N,) sine of the axis's elevation. warnings: one line each.
    """

    axis: str
    up: Array
    mounting: float
    level: float
    vertical: Array
    lean: Array
    warnings: tuple[str, ...]


def mount_of(gyro: Array, accel: Array, axis: str) -> Mount:
    """Mount of a node from its mean specific force; without an accelerometer it is taken to stand upright.

    gyro: (N, 3) rad/s. accel: (N, 3) m/s². axis: "x", "y" or "z". With z upright, x is table zero and y a
    quarter turn anticlockwise from it (clockwise when z hangs down); in any other attitude the axis itself
    is table zero. Raises InputError when the axis stands too steep to feel level Earth rate.
    """
    force = accel.mean(axis=0)
    size = float(np.linalg.norm(force))
    up = force / size if size > 1.0 else np.array([0.0, 0.0, 1.0])
    index = "xyz".index(axis)
    elevation = float(np.arcsin(np.clip(up[index], -1, 1)))
    if abs(elevation) > MAX_ELEVATION:
        raise InputError(
            f"axis {axis} stands {np.degrees(elevation):+.0f} degrees from level and feels little of level "
            f"Earth rate; "
            "choose an axis that lies level on the table"
        )
    warnings = []
    if abs(elevation) > WARN_ELEVATION:
        warnings.append(
            f"axis {axis} is {np.degrees(elevation):+.1f} degrees off level (or the accelerometer is not "
            f"calibrated); that it reads {100 * (1 - np.cos(elevation)):.2f} % low is taken into account"
        )
    mounting = 0.0
    if abs(up[2]) > 0.7:
        mounting = np.pi / 2 * np.sign(up[2]) if axis == "y" else 0.0
    else:
        warnings.append(f"z is not upright, so azimuth is that of axis {axis} at table angle zero")
    lean = accel[:, index] / size if size > 1.0 else np.zeros(len(accel))
    level = float(np.cos(elevation))
    return Mount(axis, up, float(mounting), level, np.asarray(gyro @ up), lean, tuple(warnings))


def vertical_earth(mount: Mount, latitude: float) -> Array:
    """(N,) rad/s: what the axis feels of Earth's vertical rate as the table leans it up and down.

    The accelerometer tells the lean; its bias is the same all round and so counts as the gyro's. Zero for a
    node without accelerometer.
    """
    return np.asarray(EARTH_RATE * np.sin(latitude) * mount.lean)


def check_direction(mount: Mount, t: Array, table: TableMotion) -> None:
    """Raises InputError when the gyro felt other turns than the table's file says.

    That is the other way, or in degrees.
    """
    angle = table.angle_at(t)
    step = np.gradient(t)
    steps = np.diff(angle, append=angle[-1])
    turning = np.abs(steps) > 1e-9
    if float(np.abs(steps).sum()) < MIN_TURN or not (~turning).any():
        return
    felt = (mount.vertical - np.median(mount.vertical[~turning])) * step
    ratio = float((felt * np.sign(steps))[turning].sum() / np.abs(steps)[turning].sum())
    if 40 < abs(ratio) < 80:
        raise InputError(
            f"the vertical gyro adds up to {abs(ratio):.0f} times the turns of the table, as if it were in "
            f"degrees per "
            "second; convert the record to rad/s"
        )
    if -1.4 < ratio < -0.6:
        raise InputError(
            "table.csv: the angle grows clockwise (the vertical gyro felt the opposite turn); it must grow "
            "anticlockwise seen from above: change its sign"
        )


def tilt_warning(mount: Mount, t: Array, table: TableMotion) -> list[str]:
    """A line when the table's axis is so far from the vertical that gravity turns with it, else nothing."""
    inside = (t >= table.t[0]) & (t <= table.t[-1])
    angle = (table.angle_at(t) + mount.mounting)[inside]
    lean = mount.lean[inside]
    if len(angle) < 100 or not np.ptp(lean):
        return []
    columns = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
    if np.linalg.cond(columns) > 1e3:
        columns = columns[:, :2]
    found = np.linalg.lstsq(columns, lean, rcond=None)[0]
    tilt = float(np.linalg.norm(found[1:]))
    noise = float((lean - columns @ found).std()) * np.sqrt(4 / len(lean))
    if tilt < max(5 * noise, 1e-3):
        return []
    return [
        f"the table's axis leans by {np.degrees(tilt):.2f} degrees: the vertical Earth rate in it is taken "
        "out, what the gyro feels of gravity is not; level the table"
    ]
