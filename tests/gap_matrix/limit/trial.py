"""Trial of one effect of a given size in a drive, and whether `gap` names it first in its scope."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from gap_matrix import cases, effects, recording, sensor
from gap_matrix.cases import Setup
from gap_matrix.effects import KINDS, Effect, scaled
from hubodo.gap.explain.result import GapResult
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# Beyond this confidence a name counts as given.
CONFIDENT = 0.5
RATE_HZ = 50.0


def typical(effect: Effect) -> float:
    """Return its magnitude at factor 1: the length of the scaled parameters."""
    kind = KINDS[effect.name]
    return float(np.linalg.norm([v for key, v in effect.parameters.items() if key != kind.lasting]))


def largest_possible(effect: Effect, factor: float) -> float:
    """Return the factor, reduced where no real wheel could have it."""
    while not effects.possible(scaled(effect, factor)):
        factor *= 0.9
    return factor


def in_whole_hits(setup: Setup, effect: Effect, factor: float) -> float:
    """Return the factor of the integer number of hits, for effects that occur as hits."""
    probability = effect.parameters.get("probability")
    if probability is None:
        return factor
    node = next(node for node in effects.SIDES if effect.concerns(node))
    count = len(setup.taken[node]) * (6 if effect.name == "outliers" else 1)
    return sensor.chosen(probability * factor, count) / count / probability


def tried(setup: Setup, effect: Effect | None) -> dict[str, Any]:
    """Return the result of `gap` for the drive; named: first, in its scope, and with confidence."""
    begin = time.process_time()
    result = _diagnosed(setup, [] if effect is None else [effect])
    found = [[it.effect, it.scope, round(it.confidence, 4), list(it.inseparable_from)] for it in result.found]
    row: dict[str, Any] = {"found": found, "cpu": round(time.process_time() - begin, 2)}
    if effect is None:
        return row
    head = found[0] if found else ["", "", 0.0]
    right = (head[0], head[1]) == (effect.name, effect.scope)
    first = result.search.rounds[0]
    screened = [it.gain for it in first.screened if it.candidate.term.key == (effect.name, effect.scope)]
    own = first.find_hypothesis((effect.name, effect.scope))
    return row | {
        "scope": effect.scope,
        "parameters": {key: float(value) for key, value in effect.parameters.items()},
        "named": bool(right and head[2] > CONFIDENT),
        "screened": round(max(screened), 2) if screened else None,
        "gain": None if own is None else round(own.gain, 2),
        "evidence": None if own is None else round(own.evidence, 2),
        "rivals": [
            [it.term.effect.name, it.term.scope, round(it.gain, 2), round(it.evidence, 2),
             round(it.probability, 4)]
            for it in first.hypotheses[:4]
        ],
        "nothing": round(first.null_probability, 5),
    }  # fmt: skip


def _diagnosed(setup: Setup, hidden: list[Effect]) -> GapResult:
    with tempfile.TemporaryDirectory(prefix="gap_limit_") as folder:
        recording.write(setup, hidden, Path(folder), {})
        return find_gap(read_folder(Path(folder)), read_model(Path(folder) / "model.toml"))


def drive(seed: int, seconds: float) -> Setup:
    """Return a drive of this length with nodes at half their usual rate."""
    return cases.sampled_at(cases.setup(seed, duration=seconds), RATE_HZ, np.random.default_rng(seed))
