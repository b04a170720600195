"""What the Earth does to every sensor at rest."""

STANDARD_GRAVITY = 9.80665
"""m/s², by definition (CGPM 1901)."""
