"""A user-defined effect in a file for `--effects`."""

HUM = '''"""An effect."""

from dataclasses import dataclass
from typing import ClassVar

from hubodo.effects.base import Effect, parameter
from hubodo.effects.sensor_chain import SensorChain


@dataclass(frozen=True)
class Hum(Effect):
    """gz reads k more."""

    name: ClassVar[str] = "hum"
    meaning: ClassVar[str] = "the gyro hums"
    k: float = parameter("rad/s", 0.01)

    def add_offsets(self, chain: SensorChain) -> None:
        chain.gyro[2] += self.k
'''
