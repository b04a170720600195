"""Physical constants of the Earth that a stationary sensor measures."""

import math

STANDARD_GRAVITY = 9.80665
"""m/s², by definition (CGPM 1901)."""

EARTH_RATE = 7.2921159e-5
"""rad/s: one turn in a mean sidereal day of 86164.0905 s."""

UNKNOWN_PLACE_EARTH_RATE_SIGMA = EARTH_RATE / math.sqrt(3.0)
"""rad/s, 1 sigma of the rate about the vertical at an unknown place: its sine of latitude is uniform on a
sphere."""


def vertical_earth_rate(latitude_deg: float) -> float:
    """Return the Earth's rate about the local vertical, rad/s, anticlockwise seen from above."""
    return EARTH_RATE * math.sin(math.radians(latitude_deg))
