"""Trials of one effect of a given size in one drive, and whether `gap` names it first in its scope."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from gap_matrix import cases, effects, recording, sensor
from gap_matrix.cases import Setup
from gap_matrix.effects import KINDS, Effect, scale_effect
from hubodo.gap.explain.missing_effects import MissingEffects
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# A name counts as given above this confidence.
MIN_CONFIDENCE = 0.5
RATE_HZ = 50.0


def typical_size(effect: Effect) -> float:
    """Return the size of an effect at factor 1: the norm of its scaled parameters."""
    kind = KINDS[effect.name]
    return float(np.linalg.norm([v for key, v in effect.parameters.items() if key != kind.shape_parameter]))


def reduce_to_possible(effect: Effect, factor: float) -> float:
    """Return the factor, reduced until the effect is plausible for a real wheel."""
    while not effects.is_possible(scale_effect(effect, factor)):
        factor *= 0.9
    return factor


def round_to_hits(setup: Setup, effect: Effect, factor: float) -> float:
    """Return the factor of the nearest whole number of hits, for outliers and stale samples."""
    probability = effect.parameters.get("probability")
    if probability is None:
        return factor
    node = next(node for node in effects.SIDES if effect.applies_to(node))
    count = len(setup.sample_times[node]) * (6 if effect.name == "outliers" else 1)
    return sensor.count_hits(probability * factor, count) / count / probability


def run_trial(setup: Setup, effect: Effect | None) -> dict[str, Any]:
    """Return the row of a trial with one hidden effect, or none.

    `named` is True if the effect is found first, in its scope, with a confidence above MIN_CONFIDENCE.
    """
    start_time = time.process_time()
    result = _diagnose(setup, [] if effect is None else [effect])
    findings = [
        [finding.effect, finding.scope, round(finding.confidence, 4), list(finding.inseparable_from)]
        for finding in result.found
    ]
    row: dict[str, Any] = {"found": findings, "cpu": round(time.process_time() - start_time, 2)}
    if effect is None:
        return row
    first = findings[0] if findings else ["", "", 0.0]
    is_correct = (first[0], first[1]) == (effect.name, effect.scope)
    first_round = result.search.rounds[0]
    screened_gains = [
        finding.gain
        for finding in first_round.screened
        if finding.candidate.term.key == (effect.name, effect.scope)
    ]
    hypothesis = first_round.find_hypothesis((effect.name, effect.scope))
    return row | {
        "scope": effect.scope,
        "parameters": {key: float(value) for key, value in effect.parameters.items()},
        "named": bool(is_correct and first[2] > MIN_CONFIDENCE),
        "screened": round(max(screened_gains), 2) if screened_gains else None,
        "gain": None if hypothesis is None else round(hypothesis.gain, 2),
        "evidence": None if hypothesis is None else round(hypothesis.evidence, 2),
        "rivals": [
            [finding.term.effect.name, finding.term.scope, round(finding.gain, 2), round(finding.evidence, 2),
             round(finding.probability, 4)]
            for finding in first_round.hypotheses[:4]
        ],
        "nothing": round(first_round.null_probability, 5),
    }  # fmt: skip


def _diagnose(setup: Setup, hidden: list[Effect]) -> MissingEffects:
    """Write the log of a setup and return the result of `gap`."""
    with tempfile.TemporaryDirectory(prefix="gap_limit_") as folder:
        recording.write_case_files(setup, hidden, Path(folder), {})
        return find_gap(read_folder(Path(folder)), read_model(Path(folder) / "model.toml"))


def draw_drive_setup(seed: int, duration: float) -> Setup:
    """Return the setup of a drive with nodes at half their usual rate."""
    return cases.resample_nodes(
        cases.draw_setup(seed, duration=duration), RATE_HZ, np.random.default_rng(seed)
    )
