"""Diagnoses to score: the gap workflow, one that finds nothing, and one that guesses."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import hubodo
from gap_matrix.effects import KINDS, SIDES, VEHICLE_EFFECTS
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

Diagnosis = Callable[[Path, "frozenset[str]"], dict[str, Any]]
"""A function of a case folder and the rejected names that returns the content of gap.json."""


class EverythingExcept(frozenset[str]):
    """A set that contains every name, even unknown ones, except the excluded ones."""

    def __new__(cls, excluded: Iterable[str]) -> EverythingExcept:
        excluded = frozenset(excluded)
        names = super().__new__(cls, frozenset(KINDS) - excluded)
        names.excluded = excluded
        return names

    def __contains__(self, name: object) -> bool:
        return name not in self.excluded


def run_workflow(folder: Path, reject: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Return the result that `hubodo gap` would write."""
    return find_gap(read_folder(folder), read_model(folder / "model.toml"), reject=reject).as_json()


def find_nothing(folder: Path, reject: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Return a result without findings."""
    return _build_result([])


def guess_effect(folder: Path, reject: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Return a result with one random effect at high confidence."""
    digest = hashlib.sha256((folder / "left.csv").read_bytes()).digest()
    rng = np.random.default_rng(list(digest))
    name = str(rng.choice([name for name in KINDS if name not in reject] or list(KINDS)))
    scope = "vehicle" if name in VEHICLE_EFFECTS else str(rng.choice([*SIDES, "all"]))
    gap = {"before": 1.0, "after": 1.0}
    finding = {
        "effect": name,
        "scope": scope,
        "parameters": {},
        "gap": gap,
        "held_out_gap": gap,
        "p_value": 0.0,
        "confidence": 1.0,
        "where": "",
        "runner_up": None,
        "inseparable_from": [],
    }
    return _build_result([finding])


DIAGNOSES: dict[str, Diagnosis] = {"gap": run_workflow, "silent": find_nothing, "guess": guess_effect}


def compute_fingerprint() -> str:
    """Return a fingerprint of the sources that produce logs and diagnoses.

    Results with different fingerprints are not comparable.
    """
    digest = hashlib.sha256()
    for path in sorted(_list_sources()):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


def _list_sources() -> Iterator[Path]:
    """Yield the files that influence logs and diagnoses, without those that only score and print."""
    package = Path(hubodo.__file__).parent
    for folder in ("gap", "model", "effects"):
        yield from (package / folder).rglob("*.py")
    matrix_folder = Path(__file__).parents[1]
    files = [*matrix_folder.glob("*.py"), *(matrix_folder / "judge").glob("*.py")]
    without_influence = {
        "matrix.py",
        "score.py",
        "tables.py",
        "lines.py",
        "resumed.py",
        "reliability.py",
        "calibration.py",
    }
    yield from (
        path for path in files if path.name not in without_influence and not path.name.startswith("test_")
    )


def _build_result(findings: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a result with these findings, in the form of gap.json."""
    gap = {"before": 1.0, "after": 1.0}
    return {
        "verdict": "explained" if findings else "no_gap",
        "gap": {**gap, "floor": 1.0},
        "held_out_gap": gap,
        "held_out": "",
        "found": findings,
        "remaining": [],
        "warnings": [],
    }
