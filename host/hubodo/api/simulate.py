"""A log drawn from a model file, as Python programs use it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hubodo.api.given import StrPath, given_calibration, given_model
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
    """A log of what the nodes of a model would measure: what `hubodo simulate` draws.

    >>> import hubodo
    >>> hubodo.simulate("model.toml", "loop", duration=20, seed=7)
    LoadedLog('simulated-loop': left, right, reference, truth; 20.0 s)

    Args:
        model: a model file, or a `Model`.
        drive: `random`, `loop`, `rest`, `turntable` or `poses`.
        duration: s.
        seed: draws drive and noise.
        rate: samples per second.
        reference_rate: Hz of the reference.
        calibration: errors of the nodes as they were calibrated, put into the samples.
        temperature: °C, one, or the first and the last.
        settle: s, the time constant of a warm-up between two temperatures.
        supply: V of the nodes, one, or the first and the last.
        latitude_deg: lets the Earth turn under a turntable or poses.
        azimuth_deg: of the table's zero, clockwise from north.
        angles_deg: of the table's stops.
        stop: s that the table stands.
        turn: s that it turns.

    Raises:
        ConfigError: a model file with a mistake in it.
        InputError: no such drive, too short a time for poses, a model without nodes.
    """
    known, notes = _with_errors(given_model(model), calibration)
    experiment = experiments.make_experiment(
        drive,
        known,
        duration,
        seed,
        earth=_earth(latitude_deg, azimuth_deg),
        programme=TurntableProgramme(tuple(map(math.radians, angles_deg)), stop, turn),
        temperature=temperature,
        settle=settle,
        supply=supply,
    )
    drawn = experiments.simulate(known, experiment, rate, reference_rate, seed)
    drawn = replace(experiments.with_simulation_metadata(drawn, drive, known, seed), warnings=notes)
    return LoadedLog(Path(f"simulated-{drive}"), drawn, known.vehicle)


def _earth(latitude_deg: float | None, azimuth_deg: float) -> EarthRotation | None:
    """What turns under a bench."""
    return (
        None if latitude_deg is None else EarthRotation(math.radians(latitude_deg), math.radians(azimuth_deg))
    )


def _with_errors(model: Model, calibration: StrPath | Calibration | None) -> tuple[Model, tuple[str, ...]]:
    """The model with what was calibrated, and what of that it cannot have."""
    errors, _ = given_calibration(calibration)
    return (model, ()) if errors is None else add_calibration_to_model(model, errors)
