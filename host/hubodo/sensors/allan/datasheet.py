"""Noise terms from data sheets, for comparison with a measured Allan deviation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import ConfigError, InputError
from hubodo.sensors.allan.covariance import TERMS, design_matrix
from hubodo.sensors.allan.ieee952 import ACCEL_TERM_UNITS, GYRO_TERM_UNITS
from hubodo.toml_file import MAX_TOML_NUMBER, load_toml, quote_value

# The noise density of a data sheet is one-sided (positive frequencies only): its square is 2 N².
_DENSITY_KEYS = {
    "gyro": ("noise_density", "deg/s/√Hz", math.pi / 180.0 / math.sqrt(2.0)),
    "accel": ("noise_density", "µg/√Hz", 9.80665e-6 / math.sqrt(2.0)),
}
_TERM_KEYS = {
    "gyro": {"angle_random_walk": "N", "bias_instability": "B", "rate_random_walk": "K"},
    "accel": {"velocity_random_walk": "N", "bias_instability": "B", "acceleration_random_walk": "K"},
}
_SENSOR_UNITS = {"gyro": GYRO_TERM_UNITS, "accel": ACCEL_TERM_UNITS}


@dataclass(frozen=True)
class Datasheet:
    """Noise terms of one sensor model in SI; gyro, accel: the terms N, B, K that the data sheet states."""

    name: str
    gyro: Mapping[str, float] = field(default_factory=dict)
    accel: Mapping[str, float] = field(default_factory=dict)

    def terms(self, channel: str) -> Mapping[str, float]:
        """Return the noise terms of the sensor (gyro or accelerometer) to which a channel belongs."""
        return self.gyro if channel.startswith("g") else self.accel

    def deviation(self, channel: str, tau: Array) -> Array:
        """Return the (P,) Allan deviation at tau (s) of a sensor with the noise of the data sheet."""
        squares = np.array([self.terms(channel).get(name, 0.0) ** 2 for name in TERMS])
        deviation: Array = np.sqrt(design_matrix(tau) @ squares)
        return deviation


def _datasheet(name: str, entries_by_sensor: Mapping[str, Mapping[str, float]]) -> Datasheet:
    """Convert the values of a data sheet file, by sensor and key, to noise terms in SI."""
    terms: dict[str, dict[str, float]] = {"gyro": {}, "accel": {}}
    for sensor, entries in entries_by_sensor.items():
        for key, value in entries.items():
            density, _, factor = _DENSITY_KEYS[sensor]
            if key == density:
                terms[sensor]["N"] = value * factor
            else:
                term = _TERM_KEYS[sensor][key]
                terms[sensor][term] = value / _SENSOR_UNITS[sensor][term].factor
    return Datasheet(name, terms["gyro"], terms["accel"])


CHIP_DATASHEETS = {
    "LSM6DS33": _datasheet("LSM6DS33", {"gyro": {"noise_density": 0.007}, "accel": {"noise_density": 90.0}}),
    "MPU-6050": _datasheet("MPU-6050", {"gyro": {"noise_density": 0.005}, "accel": {"noise_density": 400.0}}),
    "ADIS16405": _datasheet("ADIS16405", {"gyro": {"angle_random_walk": 2.0}}),
}
"""Typical values from the manufacturers' data sheets."""


def read_datasheet(name: str) -> Datasheet:
    """Return the data sheet of a chip of `CHIP_DATASHEETS`, or read one from a TOML file.

    The file holds `name` and the tables `gyro` and `accel`, in the units that data sheets use. gyro:
    noise_density (deg/s/√Hz) or angle_random_walk (deg/√h), bias_instability (deg/h), rate_random_walk
    (deg/h/√h). accel: noise_density (µg/√Hz) or velocity_random_walk (m/s/√h), bias_instability (µg),
    acceleration_random_walk (µg/√h). Raises InputError if name is neither a chip nor a file, ConfigError
    for an unknown key or a bad value.
    """
    chip = next((sheet for known, sheet in CHIP_DATASHEETS.items() if known.lower() == name.lower()), None)
    if chip is not None:
        return chip
    path = Path(name)
    if not path.is_file():
        raise InputError(f"--datasheet {name}: no such file, and no chip of {', '.join(CHIP_DATASHEETS)}")
    content = load_toml(path)
    label = content.pop("name", path.stem)
    if not isinstance(label, str):
        raise ConfigError(f"{name}: name = {quote_value(label)}: must be a text")
    for sensor, entries in content.items():
        known = {_DENSITY_KEYS[sensor][0], *_TERM_KEYS[sensor]} if sensor in _TERM_KEYS else set()
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
        if _DENSITY_KEYS[sensor][0] in entries and next(iter(_TERM_KEYS[sensor])) in entries:
            raise ConfigError(f"{name}: [{sensor}] gives the white noise twice; leave one out")
    return _datasheet(label, content)
