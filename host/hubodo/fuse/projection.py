"""Latitude and longitude to metres east and north of a point on the drive, by one UTM zone for all of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError

# A tenth of a second of loading that only a drive with fixes needs.
if TYPE_CHECKING:
    from pyproj import Proj
    from pyproj.database import CRSInfo

MAX_DISTANCE_FROM_ORIGIN = 300_000.0
"""m from the origin; beyond it a zone of 6 degrees is left so far that fixes are taken as false."""
_UPS_NORTH, _UPS_SOUTH = 32661, 32761
_UTM_NORTH_LIMIT, _UTM_SOUTH_LIMIT = 84.0, -80.0
"""Degrees of latitude at which UTM ends and UPS begins."""
_WIDE_ZONES = (
    (56.0, 64.0, 3.0, 12.0, 9.0),
    (72.0, 84.0, 0.0, 9.0, 3.0),
    (72.0, 84.0, 9.0, 21.0, 15.0),
    (72.0, 84.0, 21.0, 33.0, 27.0),
    (72.0, 84.0, 33.0, 42.0, 39.0),
)
"""Where the military grid widens a zone about Norway and Svalbard, in degrees.

South, north, west and east of each area, and the meridian of the zone there; the EPSG register has the
regular zones alone.
"""


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
        easting, northing = _load_projection(self.epsg)(longitude_deg, latitude_deg)
        turned = (np.asarray(easting) - self.easting) + 1j * (np.asarray(northing) - self.northing)
        turned = turned * np.exp(-1j * self.convergence) / self.scale
        return turned.real, turned.imag

    def to_geodetic(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Latitude and longitude in degrees, each (N,); the inverse of `to_local`."""
        turned = (np.asarray(x) + 1j * np.asarray(y)) * np.exp(1j * self.convergence) * self.scale
        longitude, latitude = _load_projection(self.epsg)(
            turned.real + self.easting, turned.imag + self.northing, inverse=True
        )
        return np.asarray(latitude), np.asarray(longitude)


def make_local_frame(latitude_deg: float, longitude_deg: float) -> LocalFrame:
    """The frame at a point, in the UTM zone in which the point lies; a drive keeps to one.

    Raises InputError when the point is not on Earth.
    """
    if not (math.isfinite(latitude_deg) and math.isfinite(longitude_deg)) or abs(latitude_deg) > 90.0:
        raise InputError(
            f"latitude {latitude_deg}, longitude {longitude_deg} degrees is no place on Earth; correct it"
        )
    longitude_deg = _wrap_longitude(longitude_deg)
    epsg = find_epsg(latitude_deg, longitude_deg)
    grid = _load_projection(epsg)
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


def find_epsg(latitude_deg: float, longitude_deg: float) -> int:
    """EPSG number of a point's UTM zone, with the wide zones of Norway and Svalbard; UPS at the poles."""
    if latitude_deg >= _UTM_NORTH_LIMIT:
        return _UPS_NORTH
    if latitude_deg < _UTM_SOUTH_LIMIT:
        return _UPS_SOUTH
    longitude_deg = _wrap_longitude(longitude_deg)
    for south, north, west, east, meridian in _WIDE_ZONES:
        if south <= latitude_deg < north and west <= longitude_deg < east:
            longitude_deg = meridian
            break
    areas = [
        (area.south, area.west, int(zone.code))
        for zone in _query_zones()
        if (area := zone.area_of_use) is not None
        and area.south <= latitude_deg <= area.north
        and area.west <= longitude_deg <= area.east
    ]
    # A border belongs to the zone north or east of it.
    return max(areas)[-1]


def _wrap_longitude(longitude_deg: float) -> float:
    return (longitude_deg + 180.0) % 360.0 - 180.0


@cache
def _query_zones() -> list[CRSInfo]:
    from pyproj.database import query_utm_crs_info

    return query_utm_crs_info(datum_name="WGS 84")


@cache
def _load_projection(epsg: int) -> Proj:
    from pyproj import Proj

    return Proj(f"EPSG:{epsg}")
