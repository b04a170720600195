"""What can go wrong with a node, scripted: frozen facts, each with the true time at which it happens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ScriptedFault:
    """Something that happens at `t` seconds after the board was switched on."""

    t: float


@dataclass(frozen=True)
class BusNack(ScriptedFault):
    """The next `count` transactions with the chip, from t on, are not acknowledged."""

    count: int = 1
    chip: str = "imu"


@dataclass(frozen=True)
class StuckBus(ScriptedFault):
    """The chip holds SDA low (it lost count of the clock) until nine pulses on SCL let it go."""


@dataclass(frozen=True)
class BitFlip(ScriptedFault):
    """One stored bit of a register turns over."""

    register: int = 0
    bit: int = 0
    chip: str = "imu"


@dataclass(frozen=True)
class MissedSamples(ScriptedFault):
    """The chip makes none of the `n` samples that follow t; their time passes."""

    n: int = 1
    chip: str = "imu"


@dataclass(frozen=True)
class OdrStep(ScriptedFault):
    """From t on the true sample rate is multiplied by `ratio`."""

    ratio: float = 1.0
    chip: str = "imu"


@dataclass(frozen=True)
class WrongWhoAmI(ScriptedFault):
    """From t on the identity register answers `value`."""

    value: int = 0
    chip: str = "imu"


@dataclass(frozen=True)
class BrownOut(ScriptedFault):
    """The supply dips: chips fall back to power-on registers; with `of="board"` the processor restarts."""

    of: Literal["board", "chips"] = "board"


@dataclass(frozen=True)
class Reset(ScriptedFault):
    """The RUN pin is pulled: the processor restarts, the chips keep power and registers."""


@dataclass(frozen=True)
class Stall(ScriptedFault):
    """The processor is busy for `seconds`: the firmware's next call to the board ends so much later."""

    seconds: float = 0.1


@dataclass(frozen=True)
class Unplug(ScriptedFault):
    """The USB cable is out for `seconds`; the board has its own supply and runs on."""

    seconds: float = 1.0
