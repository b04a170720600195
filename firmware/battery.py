"""How much charge a lithium cell has left, by its voltage at a light load."""

from micropython import const

UNKNOWN = const(255)
_FED_MV = const(4300)
# (mV, %), straight in between.
_CURVE = ((3300, 0), (3600, 5), (3690, 10), (3770, 30), (3840, 50), (3950, 70), (4080, 85), (4200, 100))


def percent(mv):
    """Of a supply of so many mV; UNKNOWN where nothing is measured, or no cell can have it."""
    if not 0 < mv < _FED_MV:
        return UNKNOWN
    low_mv, low = _CURVE[0]
    for high_mv, high in _CURVE:
        if mv < high_mv:
            return low + (high - low) * (mv - low_mv) // (high_mv - low_mv) if mv > low_mv else 0
        low_mv, low = high_mv, high
    return 100
