"""Convert units of gyro and accelerometer to SI, and detect data in other units."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hubodo.earth import STANDARD_GRAVITY
from hubodo.errors import InputError
from hubodo.recording import Recording, Table

_GRAVITY_RANGE_IN_G = (0.7, 1.4)
# Largest plausible rate, rad/s: the widest range of available gyros ends at 4000 deg/s (69.8 rad/s).
_MAX_GYRO_RATE = 72.0
GYRO_UNITS = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": math.pi / 180.0,
    "mdeg/s": math.pi / 180e3,
    "deg/h": math.pi / 648e3,
}
ACCEL_UNITS = {
    "m/s^2": 1.0,
    "g": STANDARD_GRAVITY,
    "mg": STANDARD_GRAVITY * 1e-3,
    "ug": STANDARD_GRAVITY * 1e-6,
}
_UNIT_ALIASES = {
    "°/s": "deg/s",
    "dps": "deg/s",
    "degree/s": "deg/s",
    "°/h": "deg/h",
    "m/s²": "m/s^2",
    "m/s2": "m/s^2",
    "m/s/s": "m/s^2",
    "rad s^-1": "rad/s",
    "rad/sec": "rad/s",
    "deg/sec": "deg/s",
    "mdps": "mdeg/s",
    "m s^-2": "m/s^2",
    "µg": "ug",
}


def si_factor(text: str) -> tuple[str, float]:
    """Return the sensor and the factor to SI of a unit ("deg/s") or of one count ("0.00875 deg/s").

    Raises InputError for another unit.
    """
    plain = text.strip()
    number, _, unit = _UNIT_ALIASES.get(plain, plain).replace("*", " ").rpartition(" ")
    unit = _UNIT_ALIASES.get(unit, unit)
    try:
        factor = float(number) if number else 1.0
    except ValueError:
        factor = math.nan
    if math.isfinite(factor) and factor != 0.0:
        for sensor, known in (("gyro", GYRO_UNITS), ("accel", ACCEL_UNITS)):
            if unit in known:
                return sensor, factor * known[unit]
    raise InputError(
        f"--unit {text!r}: give one of {', '.join((*GYRO_UNITS, *ACCEL_UNITS))}; a number before it is the "
        "value of one count, as in '0.00875 deg/s'"
    )


def sensor_of_unit(text: str) -> str:
    """Return "g" for a unit of a gyro, "a" for one of an accelerometer, "" for another text."""
    try:
        return si_factor(text)[0][0]
    except InputError:
        return ""


def explain_suspect_units(gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> str | None:
    """Return why a record is probably not in rad/s and m/s²; None if it is plausible.

    gyro, accel: (N, 3); rows that are not finite are ignored. A median specific force of 0.7 to 1.4 m/s²
    indicates data in g, a rate beyond 72 rad/s (the largest gyro range) data in deg/s.
    """
    force = np.linalg.norm(accel, axis=1)
    force = force[np.isfinite(force)]
    median_force = float(np.median(force)) if len(force) else STANDARD_GRAVITY
    if _GRAVITY_RANGE_IN_G[0] < median_force < _GRAVITY_RANGE_IN_G[1]:
        return (
            f"its accelerometer reads {median_force:.2f} m/s² where gravity is 9.8: ax, ay, az are probably "
            "in g; write them in m/s², or give --unit g"
        )
    rates = np.abs(gyro[np.isfinite(gyro).all(axis=1)])
    high_rate = float(np.quantile(rates, 0.999)) if len(rates) else 0.0
    if high_rate > _MAX_GYRO_RATE:
        return (
            f"its gyro reads {high_rate:.3g} rad/s, beyond the range of any: gx, gy, gz are probably in "
            "degrees per second; write them in rad/s, or give --unit deg/s"
        )
    return None


def explain_suspect_times(t: NDArray[np.float64]) -> str | None:
    """Return why times are probably not in seconds; None if they are plausible.

    t: (N,). An IMU is sampled several times a second, and times in ms, µs or ns are whole numbers.
    """
    interval = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    if not bool((np.abs(t - t[:1] - np.rint(t - t[:1])) < 1e-3).all()):
        return None
    for low, unit, column in ((1e6, "ns", "t_ns"), (1e3, "µs", "t_us"), (2.0, "ms", "t_ms")):
        if interval >= low:
            return (
                f"its samples are {interval:.4g} s apart: the times look like {unit}; name their column "
                f"{column}, as in --columns {column},gx,gy,gz,ax,ay,az, or write them in s"
            )
    return None


def check_node_units(table: Table, table_name: str, stated: Iterable[str] = ()) -> None:
    """Raise InputError if the data of a node are probably not in SI units.

    stated: "gyro" and "accel" if the user stated the unit, which is then not checked.
    """
    gyro, accel = (
        np.full((0, 3), np.nan) if sensor in stated else values
        for sensor, values in (("gyro", table.gyro), ("accel", table.accel))
    )
    problem = explain_suspect_units(gyro, accel) or explain_suspect_times(table.t)
    if problem is not None:
        raise InputError(f"{table_name}: {problem}")


def check_units(recording: Recording, nodes: Iterable[str], log: str, stated: Iterable[str] = ()) -> None:
    """Raise InputError if one of the given nodes of a recording is probably not in SI units.

    stated: as in `check_node_units`.
    """
    for node in nodes:
        if node in recording.nodes:
            check_node_units(recording.nodes[node], f"{log}, node {node}", stated)
