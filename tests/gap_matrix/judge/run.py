"""Run of one cell: make the log, diagnose it, add comparisons, and return a row."""

from __future__ import annotations

import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from gap_matrix.effects import KINDS
from gap_matrix.judge import black_box, logs
from gap_matrix.judge.cells import Cell
from gap_matrix.judge.diagnoses import DIAGNOSES, AllBut, Diagnosis


def run(cell: Cell, diagnosis: str) -> dict[str, Any]:
    """Return the row of a cell.

    What goes wrong in a diagnosis is a row with `error`; a cell that no seed of its list can make has
    `unmade`.
    """
    row: dict[str, Any] = {
        "key": cell.key,
        "table": cell.table,
        "name": cell.name,
        "variant": cell.variant,
        "drive": cell.drive,
        "diagnosis": diagnosis,
    }
    diagnose = DIAGNOSES[diagnosis]
    with tempfile.TemporaryDirectory(prefix="gap_matrix_") as folder:
        try:
            row["truth"] = logs.make(cell, Path(folder))
        except ValueError as error:
            return {**row, "unmade": str(error)}
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            row["result"] = diagnose(Path(folder), frozenset())
            row["seconds"] = round(time.perf_counter() - wall, 2)
            row["cpu_seconds"] = round(time.process_time() - cpu, 2)
            row |= _beside(cell, diagnose, Path(folder), row["result"])
        except Exception:  # noqa: BLE001 (a diagnosis that breaks is a failure to be counted, not the end)
            row["error"] = traceback.format_exc(limit=-4)
    return row


def _beside(cell: Cell, diagnose: Diagnosis, folder: Path, result: dict[str, Any]) -> dict[str, Any]:
    """Return comparisons for singles and controls, such as a search with only the true name."""
    if cell.table not in ("singles", "controls") or not cell.hidden:
        return {}
    name = cell.hidden[0][0]
    made = {"oracle": _forced(diagnose, folder, name)}
    if cell.table == "singles":
        return made
    wrong = _runner_up(result, name)
    others = [other for other in KINDS if other not in (name, wrong)]
    random = others[sum(cell.seeds) % len(others)]
    made["runner_up"] = {"name": wrong, **_forced(diagnose, folder, wrong)}
    made["random"] = {"name": random, **_forced(diagnose, folder, random)}
    if name == "gyro_temperature":
        permuted = diagnose(folder / "permuted", frozenset())
        made["permuted"] = {"found": [found["effect"] for found in permuted["found"]]}
    if diagnose is DIAGNOSES["gap"]:
        made["black_box"] = black_box.held_out(folder)
    return made


def _runner_up(result: dict[str, Any], truth: str) -> str:
    """Return the name that comes second to the truth, or replaces it."""
    for found in result["found"]:
        if found["effect"] != truth and found["effect"] in KINDS:
            return str(found["effect"])
        if found["runner_up"] and found["runner_up"]["effect"] in KINDS:
            return str(found["runner_up"]["effect"])
    return next(name for name in KINDS if name != truth)


def _forced(diagnose: Diagnosis, folder: Path, name: str) -> dict[str, Any]:
    """Return the held-out gap when only one name is permitted."""
    made = diagnose(folder, AllBut([name]))
    return {"held_out_gap": made["held_out_gap"], "found": [found["effect"] for found in made["found"]]}
