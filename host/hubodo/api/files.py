"""Functions that read and write vehicle, model and calibration files."""

from __future__ import annotations

from pathlib import Path

from hubodo.api.arguments import StrPath
from hubodo.calibration import file as calibration_file
from hubodo.calibration.file import Calibration
from hubodo.model import model_file, model_text
from hubodo.model.model_file import Model
from hubodo.vehicle import Vehicle
from hubodo.vehicle import load_vehicle as load_vehicle_file


def load_vehicle(path: StrPath) -> Vehicle:
    """Read `[vehicle]` and `[nodes]` of a vehicle or model file.

    Parameters
    ----------
    path : str or path-like
        The TOML file.

    Returns
    -------
    Vehicle
        Geometry of the vehicle and mounting of its nodes.

    Raises
    ------
    ConfigError
        If the file does not exist, or a key is unknown, missing or out of bounds.

    Examples
    --------
    >>> import hubodo
    >>> hubodo.load_vehicle("vehicle.toml").wheel_radius
    0.165
    """
    return load_vehicle_file(Path(path))


def read_model(path: StrPath) -> Model:
    """Read a model file.

    Parameters
    ----------
    path : str or path-like
        The TOML file.

    Returns
    -------
    Model
        Vehicle, noise, inputs and effects.

    Raises
    ------
    ConfigError
        If the file does not exist, or a key is unknown, missing or out of bounds.

    Examples
    --------
    >>> import hubodo
    >>> [modelled.effect for modelled in hubodo.read_model("leaning.toml").effects]
    [WheelCamber(angle=0.05)]
    """
    return model_file.read_model(Path(path))


def write_model(model: Model, path: StrPath) -> None:
    """Write a model file atomically; an existing file is replaced.

    Parameters
    ----------
    model : Model
        The model to write.
    path : str or path-like
        The TOML file.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    model_text.write_model(model, Path(path))


def read_calibration(path: StrPath) -> Calibration:
    """Read a calibration file, as written by `hubodo calibrate` and `hubodo warmup`.

    Parameters
    ----------
    path : str or path-like
        The TOML file.

    Returns
    -------
    Calibration
        Calibrated effects of the nodes and of the vehicle, with sigmas and provenance.

    Raises
    ------
    ConfigError
        If the file does not exist, or a key is unknown, missing or out of bounds.
    """
    return calibration_file.read_calibration(Path(path))


def write_calibration(calibration: Calibration, path: StrPath) -> None:
    """Write a calibration file atomically; an existing file is replaced.

    Parameters
    ----------
    calibration : Calibration
        The calibration to write.
    path : str or path-like
        The TOML file.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    calibration_file.write_calibration(calibration, Path(path))
