"""Units in which other programs write rates and specific forces, and what makes them SI."""

from __future__ import annotations

import math

from hubodo.errors import InputError

_GRAVITY = 9.80665
GYRO_UNITS = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": math.pi / 180.0,
    "mdeg/s": math.pi / 180e3,
    "deg/h": math.pi / 648e3,
}
ACCEL_UNITS = {"m/s^2": 1.0, "g": _GRAVITY, "mg": _GRAVITY * 1e-3, "ug": _GRAVITY * 1e-6}
_SAME = {
    "°/s": "deg/s",
    "dps": "deg/s",
    "degree/s": "deg/s",
    "°/h": "deg/h",
    "m/s²": "m/s^2",
    "m/s2": "m/s^2",
    "m/s/s": "m/s^2",
    "µg": "ug",
}


def si_factor(text: str) -> tuple[str, float]:
    """Of which sensor a unit is, and what makes it SI: of "deg/s", or of counts of "0.00875 deg/s".

    Raises InputError for another unit.
    """
    number, _, unit = text.strip().replace("*", " ").rpartition(" ")
    unit = _SAME.get(unit, unit)
    try:
        factor = float(number) if number else 1.0
    except ValueError:
        factor = math.nan
    if math.isfinite(factor) and factor != 0.0:
        for sensor, known in (("gyro", GYRO_UNITS), ("accel", ACCEL_UNITS)):
            if unit in known:
                return sensor, factor * known[unit]
    raise InputError(
        f"--unit {text!r}: give one of {', '.join((*GYRO_UNITS, *ACCEL_UNITS))}; a number before it is what "
        "one count stands for, as in '0.00875 deg/s'"
    )
