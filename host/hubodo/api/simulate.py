"""`hubodo.simulate`, which simulates a log from a model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hubodo.api.arguments import StrPath, as_calibration, as_model
from hubodo.api.log import LoadedLog
from hubodo.calibration.calibrated_model import add_calibration_to_model
from hubodo.calibration.file import Calibration
from hubodo.model import experiments
from hubodo.model.bench import TurntableProgramme
from hubodo.model.inputs import EarthRotation
from hubodo.model.model_file import Model


def simulate(
    model: StrPath | Model,
    drive: str = "random",
    *,
    duration: float = 120.0,
    seed: int = 1,
    rate: float = 200.0,
    reference_rate: float = 50.0,
    calibration: StrPath | Calibration | None = None,
    temperature: Sequence[float] = (),
    settle: float | None = None,
    supply: Sequence[float] = (),
    latitude_deg: float | None = None,
    azimuth_deg: float = 0.0,
    angles_deg: Sequence[float] = (0.0, 180.0),
    stop: float = 20.0,
    turn: float = 2.0,
) -> LoadedLog:
    """Simulate a log: the samples that the nodes of a model would measure, as `hubodo simulate` does.

    Parameters
    ----------
    model : str, path-like or Model
        Model file.
    drive : str
        `random`, `loop`, `rest`, `turntable` or `poses`.
    duration : float
        Duration, s.
    seed : int
        Seed of drive and noise.
    rate : float
        Sample rate, Hz.
    reference_rate : float
        Sample rate of the reference, Hz.
    calibration : str, path-like or Calibration, optional
        Calibration whose errors are added to the samples.
    temperature : sequence of float
        One temperature, or the first and the last, °C.
    settle : float, optional
        Time constant of an exponential warm-up between two temperatures, s.
    supply : sequence of float
        One supply voltage, or the first and the last, V.
    latitude_deg : float, optional
        Latitude in degrees; adds Earth rate to a turntable or to poses.
    azimuth_deg : float
        Azimuth of table zero, degrees clockwise from north.
    angles_deg : sequence of float
        Table angles of the stops, degrees.
    stop : float
        Duration of a stop, s.
    turn : float
        Duration of a turn, s.

    Returns
    -------
    LoadedLog
        The simulated log, with `reference` and, for drives, `truth`.

    Raises
    ------
    ConfigError
        If the model file is invalid.
    InputError
        If there is no such drive, the time is too short for poses, or the model has no nodes.

    Examples
    --------
    >>> import hubodo
    >>> hubodo.simulate("model.toml", "loop", duration=20, seed=7)
    LoadedLog('simulated-loop': left, right, reference, truth; 20.0 s)
    """
    used_model, notes = _add_calibrated_errors(as_model(model), calibration)
    experiment = experiments.make_experiment(
        drive,
        used_model,
        duration,
        seed,
        earth=_earth(latitude_deg, azimuth_deg),
        programme=TurntableProgramme(tuple(map(math.radians, angles_deg)), stop, turn),
        temperature=temperature,
        settle=settle,
        supply=supply,
    )
    recording = experiments.simulate(used_model, experiment, rate, reference_rate, seed)
    recording = replace(
        experiments.with_simulation_metadata(recording, drive, used_model, seed), warnings=notes
    )
    return LoadedLog(Path(f"simulated-{drive}"), recording, used_model.vehicle)


def _earth(latitude_deg: float | None, azimuth_deg: float) -> EarthRotation | None:
    """Return latitude and azimuth of a bench on the rotating Earth, or None."""
    return (
        None if latitude_deg is None else EarthRotation(math.radians(latitude_deg), math.radians(azimuth_deg))
    )


def _add_calibrated_errors(
    model: Model, calibration: StrPath | Calibration | None
) -> tuple[Model, tuple[str, ...]]:
    """Return the model with the calibrated errors, and notes about those that it cannot represent."""
    errors, _ = as_calibration(calibration)
    return (model, ()) if errors is None else add_calibration_to_model(model, errors)
