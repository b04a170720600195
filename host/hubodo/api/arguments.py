"""Conversion of arguments that may be a path or an object; readers are imported only when needed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.atomic_files import StrPath as StrPath
from hubodo.vehicle import Vehicle, load_vehicle

if TYPE_CHECKING:
    from hubodo.calibration.file import Calibration
    from hubodo.model.model_file import Model


def as_vehicle(vehicle: StrPath | Vehicle) -> Vehicle:
    """Return the vehicle, read from its file if a path is given; raise ConfigError as `load_vehicle` does."""
    return vehicle if isinstance(vehicle, Vehicle) else load_vehicle(Path(vehicle))


def as_model(model: StrPath | Model) -> Model:
    """Return the model, read from its file if a path is given; raise ConfigError as `read_model` does."""
    if not isinstance(model, str | os.PathLike):
        return model
    from hubodo.model.model_file import read_model

    return read_model(Path(model))


def as_calibration(
    calibration: StrPath | Calibration | None,
) -> tuple[Calibration | None, dict[str, str] | None]:
    """Return the calibration, and path and hash of its file if it was read from one; raise ConfigError."""
    if not isinstance(calibration, str | os.PathLike):
        return calibration, None
    from hubodo.calibration.file import hash_source, read_calibration

    path = Path(calibration)
    return read_calibration(path), {"file": str(path), "sha256": hash_source(path)}
