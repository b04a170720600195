"""MicroPython's module time of the virtual board, on the device clock with its offset and skew."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

from time import gmtime, localtime, mktime, ticks_add, ticks_cpu, ticks_diff, time, time_ns  # noqa: F401

import _board

ticks_us = _board.ticks_us
ticks_ms = _board.ticks_ms
_sleep_us = _board.sleep_us
_sleep_ms = _board.sleep_ms
after_sleep = []
"""Functions that deliver the events of the board; called after each sleep."""


# MicroPython checks for ctrl-C in loops, which ends the sleep.
def sleep_us(us):
    while _sleep_us(us):
        pass
    for deliver in after_sleep:
        deliver()


def sleep_ms(ms):
    while _sleep_ms(ms):
        pass
    for deliver in after_sleep:
        deliver()


def sleep(seconds):
    sleep_ms(int(seconds * 1000))
