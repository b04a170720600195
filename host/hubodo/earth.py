"""What the Earth does to every sensor at rest."""

STANDARD_GRAVITY = 9.80665
"""m/s², by definition (CGPM 1901)."""

EARTH_RATE = 7.2921159e-5
"""rad/s: a turn in a mean sidereal day of 86164.0905 s."""
