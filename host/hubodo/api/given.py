"""What a caller may give as a path, as text or as the thing itself; what reads it is loaded only then."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.vehicle import Vehicle, load_vehicle

if TYPE_CHECKING:
    from hubodo.calibration.file import Calibration
    from hubodo.model.model_file import Model

StrPath = str | os.PathLike[str]


def given_vehicle(vehicle: StrPath | Vehicle) -> Vehicle:
    """Raises ConfigError as `load_vehicle` does."""
    return vehicle if isinstance(vehicle, Vehicle) else load_vehicle(Path(vehicle))


def given_model(model: StrPath | Model) -> Model:
    """Raises ConfigError as `read_model` does."""
    if not isinstance(model, str | os.PathLike):
        return model
    from hubodo.model.model_file import read_model

    return read_model(Path(model))


def given_calibration(
    calibration: StrPath | Calibration | None,
) -> tuple[Calibration | None, dict[str, str] | None]:
    """The calibration, and its file and hash where it came from one. Raises ConfigError."""
    if not isinstance(calibration, str | os.PathLike):
        return calibration, None
    from hubodo.calibration.file import hash_source, read_calibration

    path = Path(calibration)
    return read_calibration(path), {"file": str(path), "sha256": hash_source(path)}
