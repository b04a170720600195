"""What can go wrong with a node, scripted: frozen facts, each with the true time at which it happens."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Fault:
    """Something that happens at `t` seconds after the board was switched on."""

    t: float


@dataclass(frozen=True)
class Nack(Fault):
    """The next `count` transactions with the chip, from t on, are not acknowledged."""

    count: int = 1
    chip: str = "imu"


@dataclass(frozen=True)
class StuckBus(Fault):
    """The chip holds SDA low (it lost count of the clock) until nine pulses on SCL let it go."""


@dataclass(frozen=True)
class BitFlip(Fault):
    """One stored bit of a register turns over."""

    register: int = 0
    bit: int = 0
    chip: str = "imu"


@dataclass(frozen=True)
class MissedSamples(Fault):
    """The chip makes none of the `n` samples that follow t; their time passes."""

    n: int = 1
    chip: str = "imu"


@dataclass(frozen=True)
class OdrStep(Fault):
    """From t on the true sample rate is multiplied by `ratio`."""

    ratio: float = 1.0
    chip: str = "imu"


@dataclass(frozen=True)
class WrongWhoAmI(Fault):
    """From t on the identity register answers `value`."""

    value: int = 0
    chip: str = "imu"


@dataclass(frozen=True)
class BrownOut(Fault):
    """The supply dips: chips fall back to power-on registers; with `of="board"` the processor restarts."""

    of: Literal["board", "chips"] = "board"


@dataclass(frozen=True)
class Reset(Fault):
    """The RUN pin is pulled: the processor restarts, the chips keep power and registers."""


@dataclass(frozen=True)
class Stall(Fault):
    """The processor is busy for `seconds`: the firmware's next call to the board ends so much later."""

    seconds: float = 0.1


@dataclass(frozen=True)
class Unplug(Fault):
    """The USB cable is out for `seconds`; the board has its own supply and runs on."""

    seconds: float = 1.0
