"""time of the virtual board: the device's clock, offset and skew included."""

# MicroPython's own types: not the host's code, no host types.
# mypy: ignore-errors

from time import gmtime, localtime, mktime, ticks_add, ticks_cpu, ticks_diff, time, time_ns  # noqa: F401

import _board

ticks_us = _board.ticks_us
ticks_ms = _board.ticks_ms
sleep_us = _board.sleep_us
sleep_ms = _board.sleep_ms


def sleep(seconds):
    sleep_ms(int(seconds * 1000))
