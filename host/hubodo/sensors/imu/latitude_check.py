"""Test of the latitude that was given against the latitude that the gyros measure."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE
from hubodo.errors import InputError

_MAX_DEVIATION_SIGMA = 5.0
_TOLERANCE = 0.01
"""Allowed error of the sine of the latitude, and of the relative horizontal Earth rate, beside the noise."""
_MAX_CONDITION_NUMBER = 300.0


def check_latitude(force: Array, rate: Array, rate_sigma: float, latitude: float) -> None:
    """Raise InputError if the angle between gravity and Earth rate contradicts the latitude.

    force, rate: (R, 3) calibrated means of the poses. rate_sigma: standard error of a rate, rad/s.
    latitude: rad. The rotation between both triads is unknown, so its three angles are estimated together
    with the latitude.
    Poses that do not separate these unknowns are accepted.
    """
    up = force / np.linalg.norm(force, axis=1)[:, None]
    earth = rate / np.linalg.norm(rate, axis=1)[:, None]
    rows = np.column_stack([np.cross(earth, up), -np.ones(len(up))])
    if len(rows) < 5 or np.linalg.cond(rows) > _MAX_CONDITION_NUMBER:
        return
    cosines = (earth * up).sum(axis=1)
    solution = np.linalg.lstsq(rows, -cosines, rcond=None)[0]
    residual = cosines + rows @ solution
    scatter = max(rate_sigma / EARTH_RATE, float(np.sqrt(residual @ residual / (len(rows) - 4))))
    sigma = scatter * math.sqrt(float(np.linalg.inv(rows.T @ rows)[3, 3]))
    sine = float(solution[3])
    if abs(sine - math.sin(latitude)) > _MAX_DEVIATION_SIGMA * sigma + _TOLERANCE:
        measured = math.degrees(math.asin(max(-1.0, min(1.0, sine))))
        spread = math.degrees(sigma / max(math.sqrt(max(1.0 - sine**2, 0.0)), 0.1))
        raise InputError(
            f"the gyros measure Earth rate at a latitude of {measured:.1f} ± {spread:.1g} degrees, where "
            f"{math.degrees(latitude):.4g} is given{_likely_cause(measured, latitude)}"
        )


def check_horizontal_rate(size: float, sigma: float, latitude: float) -> None:
    """Raise InputError if the horizontal Earth rate (rad/s, 1σ) contradicts the latitude (rad)."""
    deviation = abs(size - EARTH_RATE * math.cos(latitude))
    if deviation > _MAX_DEVIATION_SIGMA * sigma + _TOLERANCE * EARTH_RATE:
        measured = math.degrees(math.acos(min(1.0, size / EARTH_RATE)))
        raise InputError(
            f"the turns show a horizontal Earth rate of {math.degrees(size) * 3600:.3g} ± "
            f"{math.degrees(sigma) * 3600:.1g} deg/h, that of latitude {measured:.0f} or {-measured:.0f} "
            f"degrees, where {math.degrees(latitude):.4g} is given{_likely_cause(measured, latitude)}"
        )


def _likely_cause(measured: float, latitude: float) -> str:
    """Return the likely mistake as text; measured: degrees, by the gyros; latitude: rad, as given."""
    given = math.degrees(latitude)
    if abs(measured + given) < 2.0:
        return ": its sign is reversed; south is negative"
    if abs(abs(measured) - abs(math.degrees(given))) < 2.0:
        return ": it was given in radians; give degrees"
    return "; give the latitude of the place, not its longitude"
