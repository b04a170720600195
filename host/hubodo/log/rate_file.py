"""Read the rates of a rate table over time from a number file."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.column_names import TIME_UNITS_S, parse_heading
from hubodo.log.number_file import detect_file_kind, read_numbers
from hubodo.log.units import GYRO_UNITS, si_factor

_RATE = re.compile(r"(?:table_?)?rate(?:_(deg_s|rad_s|dps))?")
_UNIT_OF_SUFFIX = {"deg_s": "deg/s", "dps": "deg/s", "rad_s": "rad/s"}


def read_rate_file(path: Path) -> tuple[Array, Array]:
    """Return times (N,), s, and rates (N,), rad/s, from columns `t` and `rate (deg/s)` or `rate_deg_s`.

    A column `rate` without a unit is in rad/s. Raises InputError if a column is missing, or time does not
    increase.
    """
    numbers = read_numbers(path, detect_file_kind(path), None)
    t, rate = None, None
    for name, values in zip(numbers.names, numbers.values.T, strict=bool(numbers.names)):
        heading, match = parse_heading(name), _RATE.fullmatch(re.split(r"[ (\[]", name.strip().lower())[0])
        if heading.name == "t" and t is None:
            t = values * TIME_UNITS_S.get(heading.unit or "s", 1.0)
        elif match:
            sensor, factor = si_factor(heading.unit or _UNIT_OF_SUFFIX.get(match[1], "rad/s"))
            if sensor != "gyro":
                raise InputError(f"{path}: {name} is no rate; its unit is one of {', '.join(GYRO_UNITS)}")
            rate = values * factor
    if t is None or rate is None:
        raise InputError(
            f"{path}: needs a header with the columns t and rate, such as t,rate (deg/s); it has "
            f"{', '.join(numbers.names) or 'no header'}"
        )
    if not (np.isfinite(t).all() and np.isfinite(rate).all() and (np.diff(t) > 0.0).all()):
        raise InputError(f"{path}: times must increase, and rates must be numbers")
    return t, rate
