"""Latitude and longitude to metres east and north of a point on the drive, by one UTM zone for all of it."""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import ConfigError, InputError

FARTHEST = 300_000.0
"""m from the origin; beyond it a zone of 6 degrees is left so far that fixes are taken as false."""


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """East and north in true metres at an origin, made from one UTM (near a pole: UPS) grid.

    latitude_deg, longitude_deg: of the origin. epsg: of the grid. convergence: rad from true to grid north,
    clockwise positive; scale: grid metres per true metre; both at the origin. A grid leans by up to 3 degrees
    and shrinks by 4e-4; without both undone neither a compass nor a wheel's radius would agree with it.
    """

    latitude_deg: float
    longitude_deg: float
    epsg: int
    easting: float
    northing: float
    convergence: float
    scale: float

    def to_local(self, latitude_deg: Array, longitude_deg: Array) -> tuple[Array, Array]:
        """x east, y north of the origin, m, each (N,); infinite where the grid does not reach."""
        easting, northing = _grid(self.epsg)(longitude_deg, latitude_deg)
        turned = (np.asarray(easting) - self.easting) + 1j * (np.asarray(northing) - self.northing)
        turned = turned * np.exp(-1j * self.convergence) / self.scale
        return turned.real, turned.imag

    def to_geodetic(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Latitude and longitude in degrees, each (N,); the inverse of `to_local`."""
        turned = (np.asarray(x) + 1j * np.asarray(y)) * np.exp(1j * self.convergence) * self.scale
        longitude, latitude = _grid(self.epsg)(
            turned.real + self.easting, turned.imag + self.northing, inverse=True
        )
        return np.asarray(latitude), np.asarray(longitude)


def local_frame(latitude_deg: float, longitude_deg: float) -> LocalFrame:
    """The frame at a point, in the UTM zone in which the point lies; a drive keeps to one.

    Raises InputError when the point is not on Earth, ConfigError when pyproj is not installed.
    """
    if not (math.isfinite(latitude_deg) and math.isfinite(longitude_deg)) or abs(latitude_deg) > 90.0:
        raise InputError(
            f"latitude {latitude_deg}, longitude {longitude_deg} degrees is no place on Earth; correct it"
        )
    longitude_deg = (longitude_deg + 180.0) % 360.0 - 180.0
    epsg = epsg_of(latitude_deg, longitude_deg)
    grid = _grid(epsg)
    easting, northing = grid(longitude_deg, latitude_deg)
    factors = grid.get_factors(longitude_deg, latitude_deg)
    return LocalFrame(
        latitude_deg,
        longitude_deg,
        epsg,
        float(easting),
        float(northing),
        math.radians(float(factors.meridian_convergence)),
        float(factors.meridional_scale),
    )


def epsg_of(latitude_deg: float, longitude_deg: float) -> int:
    """EPSG number of the UTM zone of a point, with the widened zones of Norway and Svalbard; UPS at the
    poles."""
    if latitude_deg >= 84.0:
        return 32661
    if latitude_deg < -80.0:
        return 32761
    zone = int((longitude_deg + 180.0) % 360.0 // 6.0) + 1
    if 56.0 <= latitude_deg < 64.0 and 3.0 <= longitude_deg < 12.0:
        zone = 32
    if latitude_deg >= 72.0 and 0.0 <= longitude_deg < 42.0:
        zone = 31 + 2 * int((longitude_deg + 3.0) // 12.0)
    return (32600 if latitude_deg >= 0.0 else 32700) + zone


_grids: dict[int, Any] = {}


def _grid(epsg: int) -> Any:
    if epsg not in _grids:
        try:
            pyproj = importlib.import_module("pyproj")
        except ImportError:
            raise ConfigError(
                "GNSS fixes need pyproj, which is not installed; pip install 'hubodo[graph]'"
            ) from None
        _grids[epsg] = pyproj.Proj(f"EPSG:{epsg}")
    return _grids[epsg]
