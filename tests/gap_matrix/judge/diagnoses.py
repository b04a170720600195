"""Diagnoses to score: the gap workflow, one that never finds anything, and one that guesses."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import hubodo
from gap_matrix.effects import KINDS, SIDES, VEHICLE
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

Diagnosis = Callable[[Path, "frozenset[str]"], dict[str, Any]]
"""From a folder and the names not to be considered to what stands in gap.json."""


class AllBut(frozenset[str]):
    """A set of all names, even unknown ones, except some."""

    def __new__(cls, kept: Iterable[str]) -> AllBut:
        kept = frozenset(kept)
        made = super().__new__(cls, frozenset(KINDS) - kept)
        made.kept = kept
        return made

    def __contains__(self, name: object) -> bool:
        return name not in self.kept


def workflow(folder: Path, reject: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Return the result that `hubodo gap` would write."""
    return find_gap(read_folder(folder), read_model(folder / "model.toml"), reject=reject).as_json()


def silent(folder: Path, reject: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Return a result without findings."""
    return _answer([])


def guess(folder: Path, reject: frozenset[str] = frozenset()) -> dict[str, Any]:
    """Return a result with one random effect at high confidence."""
    digest = hashlib.sha256((folder / "left.csv").read_bytes()).digest()
    rng = np.random.default_rng(list(digest))
    name = str(rng.choice([name for name in KINDS if name not in reject] or list(KINDS)))
    scope = "vehicle" if name in VEHICLE else str(rng.choice([*SIDES, "all"]))
    gap = {"before": 1.0, "after": 1.0}
    found = {
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
    return _answer([found])


DIAGNOSES: dict[str, Diagnosis] = {"gap": workflow, "silent": silent, "guess": guess}


def fingerprint() -> str:
    """Return a fingerprint of the sources of logs and diagnoses.

    Results of other sources are not comparable.
    """
    made = hashlib.sha256()
    for path in sorted(_sources()):
        made.update(path.read_bytes())
    return made.hexdigest()[:8]


def _sources() -> Iterator[Path]:
    root = Path(hubodo.__file__).parent
    for room in ("gap", "model", "effects"):
        yield from (root / room).rglob("*.py")
    here = Path(__file__).parents[1]
    made = [*here.glob("*.py"), *(here / "judge").glob("*.py")]
    told = {
        "matrix.py",
        "score.py",
        "tables.py",
        "lines.py",
        "resumed.py",
        "reliability.py",
        "calibration.py",
    }
    yield from (path for path in made if path.name not in told and not path.name.startswith("test_"))


def _answer(found: list[dict[str, Any]]) -> dict[str, Any]:
    gap = {"before": 1.0, "after": 1.0}
    return {
        "verdict": "explained" if found else "no_gap",
        "gap": {**gap, "floor": 1.0},
        "held_out_gap": gap,
        "held_out": "",
        "found": found,
        "remaining": [],
        "warnings": [],
    }
