"""Projection of latitude and longitude to metres east and north of a point, in one UTM zone per drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError

# The import takes a tenth of a second, and only a drive with fixes needs it.
if TYPE_CHECKING:
    from pyproj import Proj
    from pyproj.database import CRSInfo

MAX_DISTANCE_FROM_ORIGIN = 300_000.0
"""m; beyond it a fix is so far outside its 6 degree zone that it is rejected."""
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
"""Areas of Norway and Svalbard in which the military grid widens a zone, in degrees.

South, north, west and east of each area, and a meridian in the zone that covers it; the EPSG register holds
regular zones only.
"""


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """East and north in true metres from an origin, derived from one UTM (near a pole: UPS) grid.

    A grid is rotated by up to 3 degrees and scaled by up to 4e-4; both are undone here, since compass
    headings and wheel radii refer to true north and true metres.

    Attributes
    ----------
    latitude_deg, longitude_deg : degrees, position of the origin.
    epsg : number of the grid.
    easting, northing : grid metres, position of the origin.
    convergence : rad from true to grid north at the origin, clockwise positive.
    scale : grid metres per true metre at the origin.
    """

    latitude_deg: float
    longitude_deg: float
    epsg: int
    easting: float
    northing: float
    convergence: float
    scale: float

    def to_local(self, latitude_deg: Array, longitude_deg: Array) -> tuple[Array, Array]:
        """Return x east and y north of the origin, m, each (N,); infinite where the grid does not reach."""
        easting, northing = _load_projection(self.epsg)(longitude_deg, latitude_deg)
        grid_offset = (np.asarray(easting) - self.easting) + 1j * (np.asarray(northing) - self.northing)
        grid_offset = grid_offset * np.exp(-1j * self.convergence) / self.scale
        return grid_offset.real, grid_offset.imag

    def to_geodetic(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return latitude and longitude in degrees, each (N,); the inverse of `to_local`."""
        grid_offset = (np.asarray(x) + 1j * np.asarray(y)) * np.exp(1j * self.convergence) * self.scale
        longitude, latitude = _load_projection(self.epsg)(
            grid_offset.real + self.easting, grid_offset.imag + self.northing, inverse=True
        )
        return np.asarray(latitude), np.asarray(longitude)


def make_local_frame(latitude_deg: float, longitude_deg: float) -> LocalFrame:
    """Return the frame with its origin at a point, in the UTM zone of that point.

    Raises InputError when the point is not on Earth.
    """
    if not (math.isfinite(latitude_deg) and math.isfinite(longitude_deg)) or abs(latitude_deg) > 90.0:
        raise InputError(
            f"latitude {latitude_deg}, longitude {longitude_deg} degrees is not on Earth; correct it"
        )
    longitude_deg = _wrap_longitude(longitude_deg)
    epsg = find_epsg(latitude_deg, longitude_deg)
    grid = _load_projection(epsg)
    easting, northing = grid(longitude_deg, latitude_deg)
    distortion = grid.get_factors(longitude_deg, latitude_deg)
    return LocalFrame(
        latitude_deg,
        longitude_deg,
        epsg,
        float(easting),
        float(northing),
        math.radians(float(distortion.meridian_convergence)),
        float(distortion.meridional_scale),
    )


def find_epsg(latitude_deg: float, longitude_deg: float) -> int:
    """Return the EPSG number of a point's UTM zone (Norway's wide zones included), or of UPS."""
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
    # A point on a border belongs to the zone north or east of it.
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
