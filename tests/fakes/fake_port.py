"""A stand-in for a MicroPython port on CPython: `micropython`, `machine` and the ticks of `time`.

Ticks count modulo 2^30 as on a board, and advance only by `time.run` and by sleeping.
"""

import sys
import time
import types

TICKS = 1 << 30


class FakeTicks:
    """Ticks of the fake port; now_us: time since its start, not wrapped."""

    def __init__(self) -> None:
        self.now_us = 0.0

    def us(self) -> int:
        return int(self.now_us) % TICKS

    def ms(self) -> int:
        return int(self.now_us) // 1000 % TICKS

    def sleep_us(self, us: float) -> None:
        self.now_us += us


def ticks_add(ticks: int, delta: int) -> int:
    if not -TICKS // 2 <= delta < TICKS // 2:
        raise OverflowError("ticks interval overflow")
    return (ticks + delta) % TICKS


def ticks_diff(end: int, start: int) -> int:
    return (end - start + TICKS // 2) % TICKS - TICKS // 2


def install(ticks: FakeTicks) -> None:
    """Make the port's modules importable; existing functions of CPython's `time` stay."""
    micropython = types.ModuleType("micropython")
    micropython.const = micropython.native = micropython.viper = lambda value: value  # type: ignore[attr-defined]
    micropython.kbd_intr = lambda char: None  # type: ignore[attr-defined]
    sys.modules["micropython"] = micropython
    machine = types.ModuleType("machine")
    # Only the names of buses and pins: tests supply their own.
    machine.SPI = machine.Pin = None  # type: ignore[attr-defined]
    sys.modules["machine"] = machine
    functions = {
        "ticks_us": ticks.us,
        "ticks_ms": ticks.ms,
        "sleep_us": ticks.sleep_us,
        "sleep_ms": lambda ms: ticks.sleep_us(1000 * ms),
        "run": ticks.sleep_us,
        "ticks_add": ticks_add,
        "ticks_diff": ticks_diff,
    }
    for name, function in functions.items():
        setattr(time, name, function)


PORT_TICKS = FakeTicks()
