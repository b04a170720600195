"""From the wire's units to SI."""

import math

G = 9.80665
"""m/s² in one g."""
RAD_PER_NANO_DEG = math.pi / 180 * 1e-9
