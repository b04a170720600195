"""The latitude of a drive, from the vehicle file or the fixes, and a warning where the two differ."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hubodo.recording import Recording
from hubodo.vehicle import Vehicle

_MAX_DIFFERENCE_DEG = 1.0
"""Degrees, 111 km: the Earth rate about the vertical changes by 0.2 °/h at most, and no drive is longer."""


def add_latitude(vehicle: Vehicle, recording: Recording) -> Vehicle:
    """Return the vehicle with the latitude of its log's fixes, if its file gives none."""
    fixes = _median_fix(recording)
    if vehicle.latitude_deg is not None or fixes is None or abs(fixes[0]) > 90.0:
        return vehicle
    return replace(vehicle, latitude_deg=fixes[0])


def latitude_warnings(vehicle: Vehicle, recording: Recording) -> tuple[str, ...]:
    """Return a warning where vehicle file and fixes differ in latitude; it names the likely mistake."""
    fixes = _median_fix(recording)
    if (
        vehicle.latitude_deg is None
        or fixes is None
        or abs(fixes[0] - vehicle.latitude_deg) < _MAX_DIFFERENCE_DEG
    ):
        return ()
    latitude, longitude = fixes
    mistakes = (
        (longitude, "it looks like their longitude"),
        (-latitude, "it has the wrong sign"),
        (math.radians(latitude), "it looks like radians"),
    )
    likely = next(
        (f"; {text}" for value, text in mistakes if abs(value - vehicle.latitude_deg) < _MAX_DIFFERENCE_DEG),
        "",
    )
    return (
        f"latitude_deg = {vehicle.latitude_deg:g} of the vehicle file, but the fixes are at {latitude:.2f} "
        f"degrees{likely}; correct it, or leave it out",
    )


def _median_fix(recording: Recording) -> tuple[float, float] | None:
    """Return the median latitude and longitude of a log's fixes, degrees; None without fixes."""
    gnss = recording.gnss
    if gnss is None or not len(gnss):
        return None
    return float(np.median(gnss["latitude_deg"])), float(np.median(gnss["longitude_deg"]))
