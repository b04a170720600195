"""What the odometry of a log was made with, from what is kept in it; no odometry is loaded for that."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from hubodo.calibration.file import Calibration, parse_calibration
from hubodo.errors import ConfigError
from hubodo.log.logfile import Log
from hubodo.toml_file import parse_toml
from hubodo.vehicle import Vehicle, parse_vehicle


@dataclass(frozen=True, eq=False)
class Setup:
    """What the odometry of a log was made with.

    vehicle: None where the log does not tell. rate_hz: poses a second at most.
    """

    vehicle: Vehicle | None
    calibration: Calibration | None
    rate_hz: float | None


def setup_of(log: Log) -> Setup:
    """Vehicle, calibration and rate that a log carries. Raises ConfigError when they make no sense."""
    files = log.attachments
    vehicle = calibration = None
    if "vehicle.toml" in files:
        where = f"{log.path}: vehicle.toml"
        try:
            vehicle = parse_vehicle(parse_toml(files["vehicle.toml"].decode(), Path(where)), where)
        except UnicodeDecodeError as error:
            raise ConfigError(f"{where}: not TOML: {error}; give --vehicle") from None
    if "calibration.toml" in files:
        text = files["calibration.toml"].decode("utf-8", "replace")
        calibration = parse_calibration(text, Path(f"{log.path}: calibration.toml"))
    rate = log.metadata.get("odometry_rate_hz", "")
    try:
        rate_hz = float(rate) if rate else None
    except ValueError:
        raise ConfigError(f"{log.path}: odometry_rate_hz = {rate[:40]!r} in it is no number") from None
    return Setup(vehicle, calibration, rate_hz if rate_hz is not None and 0.0 < rate_hz < math.inf else None)
