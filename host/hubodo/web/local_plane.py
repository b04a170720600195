"""Positions in metres about an origin, for drawing."""

from __future__ import annotations

import math

_WGS84_RADIUS_M, _WGS84_ECCENTRICITY_SQUARED = 6_378_137.0, 6.694_379_990_141e-3


def local_east_north(
    latitude_deg: float, longitude_deg: float, origin_deg: tuple[float, float]
) -> tuple[float, float]:
    """Return metres east and north of the origin, by its radii of curvature (WGS 84), for drawing."""
    latitude = math.radians(origin_deg[0])
    squared = 1.0 - _WGS84_ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    normal_radius = _WGS84_RADIUS_M / math.sqrt(squared)
    meridian_radius = normal_radius * (1.0 - _WGS84_ECCENTRICITY_SQUARED) / squared
    east = math.remainder(longitude_deg - origin_deg[1], 360.0)
    return (
        math.radians(east) * normal_radius * math.cos(latitude),
        math.radians(latitude_deg - origin_deg[0]) * meridian_radius,
    )
