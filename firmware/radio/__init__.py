"""Radio links by nRF24L01+ or ESP-NOW through a receiver. A package, so that imports stay fast."""

from micropython import const

FIRST = const(0)
"""Number of the first ESP-NOW packet after a start; then 1 to LAST repeatedly."""
LAST = const(127)
