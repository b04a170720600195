"""The files of vehicle, model and calibration, read and written by a path that may be text."""

from __future__ import annotations

from pathlib import Path

from hubodo.api.given import StrPath
from hubodo.calibration import file as calibration_file
from hubodo.calibration.file import Calibration
from hubodo.model import model_file
from hubodo.model.model_file import Model
from hubodo.vehicle import Vehicle
from hubodo.vehicle import load_vehicle as load


def load_vehicle(path: StrPath) -> Vehicle:
    """`[vehicle]` and `[nodes]` of a vehicle or model file.

    >>> import hubodo
    >>> hubodo.load_vehicle("vehicle.toml").wheel_radius
    0.165

    Raises:
        ConfigError: no such file, or a key that is unknown, missing or impossible.
    """
    return load(Path(path))


def read_model(path: StrPath) -> Model:
    """A model file.

    >>> import hubodo
    >>> [one.effect for one in hubodo.read_model("leaning.toml").effects]
    [WheelCamber(angle=0.05)]

    Raises:
        ConfigError: no such file, or a key that is unknown, missing or impossible.
    """
    return model_file.read_model(Path(path))


def write_model(model: Model, path: StrPath) -> None:
    """Write a model file whole or not at all; one that is there is replaced."""
    model_file.write_model(model, Path(path))


def read_calibration(path: StrPath) -> Calibration:
    """A file of `hubodo calibrate` or `hubodo warmup`.

    Raises:
        ConfigError: no such file, or a key that is unknown, missing or impossible.
    """
    return calibration_file.read_calibration(Path(path))


def write_calibration(calibration: Calibration, path: StrPath) -> None:
    """Write a calibration file whole or not at all; one that is there is replaced."""
    calibration_file.write_calibration(calibration, Path(path))
