"""Scripted faults of a node: frozen records, each with the true time at which it happens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ScriptedFault:
    """A fault that happens `t` seconds after the board was switched on."""

    t: float


@dataclass(frozen=True)
class BusNack(ScriptedFault):
    """The next `count` transactions with the chip after t are not acknowledged."""

    count: int = 1
    chip: str = "imu"


@dataclass(frozen=True)
class StuckBus(ScriptedFault):
    """The chip holds SDA low, out of step with the clock, until nine pulses on SCL release it."""


@dataclass(frozen=True)
class BitFlip(ScriptedFault):
    """One stored bit of a register flips."""

    register: int = 0
    bit: int = 0
    chip: str = "imu"


@dataclass(frozen=True)
class MissedSamples(ScriptedFault):
    """The `n` samples after t are not measured."""

    n: int = 1
    chip: str = "imu"


@dataclass(frozen=True)
class OdrStep(ScriptedFault):
    """The true sample rate is multiplied by `ratio` from t on."""

    ratio: float = 1.0
    chip: str = "imu"


@dataclass(frozen=True)
class WrongWhoAmI(ScriptedFault):
    """The identity register reads `value` from t on."""

    value: int = 0
    chip: str = "imu"


@dataclass(frozen=True)
class BrownOut(ScriptedFault):
    """The supply dips: chips reset, and with `affected="board"` the processor restarts too."""

    affected: Literal["board", "chips"] = "board"


@dataclass(frozen=True)
class Reset(ScriptedFault):
    """The RUN pin is pulled: the processor restarts; chips keep power and registers."""


@dataclass(frozen=True)
class Stall(ScriptedFault):
    """The processor is busy for `seconds`, which delays the next call of the firmware to the board."""

    seconds: float = 0.1


@dataclass(frozen=True)
class Unplug(ScriptedFault):
    """The USB cable is unplugged for `seconds`; the board runs on from its own supply."""

    seconds: float = 1.0
