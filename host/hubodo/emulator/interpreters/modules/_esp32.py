"""MicroPython's module esp32 of the virtual board: the pin that ends a sleep, with the port's refusals."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

import _board
import machine

WAKEUP_ALL_LOW = False
WAKEUP_ANY_HIGH = True

_RTC_PINS = {
    "ESP32": (0, 2, 4, 12, 13, 14, 15, 25, 26, 27, 32, 33, 34, 35, 36, 37, 38, 39),
    "ESP32S3": tuple(range(22)),
}.get(_board.machine_name().split(" ")[-1])
"""Pins of the RTC, which alone end a sleep; a C3 has no such pins, and no such function."""

if _RTC_PINS is not None:

    def wake_on_ext0(pin, level):
        """Let a level of the pin end `machine.lightsleep`; here only WAKEUP_ANY_HIGH."""
        if pin._id not in _RTC_PINS:
            raise ValueError("invalid pin")
        if not level:
            raise NotImplementedError("WAKEUP_ALL_LOW")
        machine.Pin._wake = pin._id + 1
