"""What a data sheet promises of a sensor's noise, to be laid beside what was measured."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import ConfigError, InputError
from hubodo.sensors.allan.covariance import TERMS, design
from hubodo.sensors.allan.ieee952 import ACCEL, GYRO
from hubodo.toml_file import MAX_TOML_NUMBER, load_toml, quote_value

FloatArray = NDArray[np.float64]

# A data sheet's density counts positive frequencies alone: its square is 2 N².
_DENSITY = {
    "gyro": ("noise_density", "deg/s/√Hz", math.pi / 180.0 / math.sqrt(2.0)),
    "accel": ("noise_density", "µg/√Hz", 9.80665e-6 / math.sqrt(2.0)),
}
_KEYS = {
    "gyro": {"angle_random_walk": "N", "bias_instability": "B", "rate_random_walk": "K"},
    "accel": {"velocity_random_walk": "N", "bias_instability": "B", "acceleration_random_walk": "K"},
}
_UNITS = {"gyro": GYRO, "accel": ACCEL}


@dataclass(frozen=True)
class Datasheet:
    """Noise terms of one part in SI; gyro, accel: by name, N, B, K as far as the sheet tells."""

    name: str
    gyro: Mapping[str, float] = field(default_factory=dict)
    accel: Mapping[str, float] = field(default_factory=dict)

    def terms(self, channel: str) -> Mapping[str, float]:
        """Those of a channel's sensor."""
        return self.gyro if channel.startswith("g") else self.accel

    def deviation(self, channel: str, tau: FloatArray) -> FloatArray:
        """(P,) Allan deviation at tau (s) of a sensor that is as the sheet says."""
        squares = np.array([self.terms(channel).get(name, 0.0) ** 2 for name in TERMS])
        made: FloatArray = np.sqrt(design(tau) @ squares)
        return made


def _sheet(name: str, told: Mapping[str, Mapping[str, float]]) -> Datasheet:
    """told: by sensor, keys of a file and numbers in its units."""
    made: dict[str, dict[str, float]] = {"gyro": {}, "accel": {}}
    for sensor, entries in told.items():
        for key, value in entries.items():
            density, _, factor = _DENSITY[sensor]
            if key == density:
                made[sensor]["N"] = value * factor
            else:
                term = _KEYS[sensor][key]
                made[sensor][term] = value / _UNITS[sensor][term].factor
    return Datasheet(name, made["gyro"], made["accel"])


CHIPS = {
    "LSM6DS33": _sheet("LSM6DS33", {"gyro": {"noise_density": 0.007}, "accel": {"noise_density": 90.0}}),
    "MPU-6050": _sheet("MPU-6050", {"gyro": {"noise_density": 0.005}, "accel": {"noise_density": 400.0}}),
    "ADIS16405": _sheet("ADIS16405", {"gyro": {"angle_random_walk": 2.0}}),
}
"""Typical values of their makers' data sheets."""


def read_datasheet(name: str) -> Datasheet:
    """A chip of `CHIPS`, or a TOML file: `name`, and tables `gyro` and `accel` in the units that sheets use.

    gyro: noise_density (deg/s/√Hz) or angle_random_walk (deg/√h), bias_instability (deg/h), rate_random_walk
    (deg/h/√h). accel: noise_density (µg/√Hz) or velocity_random_walk (m/s/√h), bias_instability (µg),
    acceleration_random_walk (µg/√h). Raises InputError for neither, ConfigError for a key or value that is
    none.
    """
    chip = next((sheet for known, sheet in CHIPS.items() if known.lower() == name.lower()), None)
    if chip is not None:
        return chip
    path = Path(name)
    if not path.is_file():
        raise InputError(f"--datasheet {name}: no such file, and no chip of {', '.join(CHIPS)}")
    content = load_toml(path)
    label = content.pop("name", path.stem)
    if not isinstance(label, str):
        raise ConfigError(f"{name}: name = {quote_value(label)}: must be a text")
    for sensor, entries in content.items():
        known = {_DENSITY[sensor][0], *_KEYS[sensor]} if sensor in _KEYS else set()
        if not isinstance(entries, dict) or not known:
            raise ConfigError(f"{name}: {quote_value(sensor)} is none of name, [gyro], [accel]")
        for key, value in entries.items():
            if key not in known:
                raise ConfigError(
                    f"{name}: [{sensor}] {quote_value(key)} is none of {', '.join(sorted(known))}"
                )
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float)
                or not 0.0 < value <= MAX_TOML_NUMBER
            ):
                raise ConfigError(f"{name}: [{sensor}] {key} = {quote_value(value)}: give a number above 0")
        if _DENSITY[sensor][0] in entries and next(iter(_KEYS[sensor])) in entries:
            raise ConfigError(f"{name}: [{sensor}] gives the white noise twice; leave one out")
    return _sheet(label, content)
