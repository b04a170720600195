"""Drives of a real car, the model of its geometry and noise, and the largest error of an injected value."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import wanted  # noqa: E402
from hubodo.effects import BY_NAME  # noqa: E402
from hubodo.gap.judge.search import build_initial_state  # noqa: E402
from hubodo.gap.problem.build import build_problem  # noqa: E402
from hubodo.gap.refit.refit import refit_with_weights  # noqa: E402
from hubodo.gap.state.terms import ModelTerm  # noqa: E402
from hubodo.log.csv_folder import read_folder  # noqa: E402
from hubodo.model.model_file import Model, read_model  # noqa: E402
from hubodo.recording import Recording, Table  # noqa: E402
from vehicles import model_toml  # noqa: E402

CAR = model_toml(
    0.2924,
    1.42,
    gyro_noise=0.025,
    accel_noise=1.2,
    inputs='speed = "nodes"\nyaw_rate = "frame.gz"\n',
    facing={"left": "left", "right": "right"},
)
# Largest accepted error of a value: share of the injected size, or number of sigmas.
MAX_ERROR_SHARE, MAX_ERROR_SIGMA = 0.25, 3.0
DELAY_EFFECTS = ("time_offset", "clock_skew", "gyro_lag")


def read_car_model(folder: Path, effects: str = "") -> Model:
    """Return the model of the car with further effects, as text of a model file, written to a folder."""
    path = folder / "car.toml"
    path.write_text(CAR + effects, "utf-8")
    return read_model(path)


def read_drive(name: str) -> Recording:
    """Return a recording of the car, or a half of one: `drive-1/first`, `drive-1/second`."""
    drive, _, half = name.partition("/")
    recording = read_folder(wanted.recording("car") / drive)
    return recording if not half else _take_half(recording, half)


def _take_half(recording: Recording, half: str) -> Recording:
    """Return the samples of the nodes before or after the middle of a recording, with their time stamps."""
    starts, ends = zip(*((table.t[0], table.t[-1]) for table in recording.nodes.values()), strict=True)
    middle = 0.5 * (min(starts) + max(ends))
    nodes = {}
    for name, table in recording.nodes.items():
        selected = {"first": table.t < middle, "second": table.t >= middle}[half]
        nodes[name] = Table({column: table[column][selected] for column in table})
    return replace(recording, nodes=nodes)


def measure_recorded(drive: Recording, model: Model, effect: str, node: str) -> Mapping[str, float]:
    """Return the delay of a node in a drive as recorded, by a fit beside the effects of the model.

    Empty for other effects.
    """
    if effect not in DELAY_EFFECTS:
        return {}
    state = build_initial_state(build_problem(drive, model))
    fit = refit_with_weights(state.with_term(ModelTerm(BY_NAME[effect](), node)))
    return next(term.effect.values() for term in fit.state.terms if term.key == (effect, node))
