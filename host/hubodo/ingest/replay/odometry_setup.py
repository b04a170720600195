"""Vehicle, calibration and rate of the odometry in a log, read without importing the odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from hubodo.calibration.file import Calibration, parse_calibration
from hubodo.errors import ConfigError
from hubodo.log.logfile import Log
from hubodo.toml_file import parse_toml
from hubodo.vehicle import Vehicle, parse_vehicle

_SIMULATED_MODEL = "simulated.model"
"""Metadata of a simulated log: the model file, whose vehicle it drove."""


@dataclass(frozen=True, eq=False)
class OdometrySetup:
    """Settings of the odometry in a log; vehicle: None if unknown; rate_hz: maximum rate of poses."""

    vehicle: Vehicle | None
    calibration: Calibration | None
    rate_hz: float | None


def read_odometry_setup(log: Log) -> OdometrySetup:
    """Return vehicle, calibration and rate stored in a log; raise ConfigError if they are invalid."""
    files = log.attachments
    vehicle = calibration = None
    if "vehicle.toml" in files:
        where = f"{log.path}: vehicle.toml"
        try:
            vehicle = parse_vehicle(parse_toml(files["vehicle.toml"].decode(), Path(where)), where)
        except UnicodeDecodeError as error:
            raise ConfigError(f"{where}: not TOML: {error}; give --vehicle") from None
    elif _SIMULATED_MODEL in log.metadata:
        where = f"{log.path}: {_SIMULATED_MODEL}"
        vehicle = parse_vehicle(parse_toml(log.metadata[_SIMULATED_MODEL], Path(where)), where)
    if "calibration.toml" in files:
        text = files["calibration.toml"].decode("utf-8", "replace")
        calibration = parse_calibration(text, Path(f"{log.path}: calibration.toml"))
    rate = log.metadata.get("odometry_rate_hz", "")
    try:
        rate_hz = float(rate) if rate else None
    except ValueError:
        raise ConfigError(f"{log.path}: odometry_rate_hz = {rate[:40]!r} is not a number") from None
    return OdometrySetup(
        vehicle, calibration, rate_hz if rate_hz is not None and 0.0 < rate_hz < math.inf else None
    )
