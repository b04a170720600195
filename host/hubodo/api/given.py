"""What a caller may give as a path, as text or as the thing itself."""

from __future__ import annotations

import os
from pathlib import Path

from hubodo.calibration.file import Calibration, read_calibration, source_hash
from hubodo.model.model_file import Model, read_model
from hubodo.vehicle import Vehicle, load_vehicle

StrPath = str | os.PathLike[str]


def given_vehicle(vehicle: StrPath | Vehicle) -> Vehicle:
    """Raises ConfigError as `load_vehicle` does."""
    return vehicle if isinstance(vehicle, Vehicle) else load_vehicle(Path(vehicle))


def given_model(model: StrPath | Model) -> Model:
    """Raises ConfigError as `read_model` does."""
    return model if isinstance(model, Model) else read_model(Path(model))


def given_calibration(
    calibration: StrPath | Calibration | None,
) -> tuple[Calibration | None, dict[str, str] | None]:
    """The calibration, and its file and hash where it came from one. Raises ConfigError."""
    if calibration is None or isinstance(calibration, Calibration):
        return calibration, None
    path = Path(calibration)
    return read_calibration(path), {"file": str(path), "sha256": source_hash(path)}
