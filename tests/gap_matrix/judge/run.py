"""Run of one cell: write the log, diagnose it, add comparisons, and return a row."""

from __future__ import annotations

import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from gap_matrix.effects import KINDS
from gap_matrix.judge import black_box, logs
from gap_matrix.judge.cells import Cell
from gap_matrix.judge.diagnoses import DIAGNOSES, Diagnosis, EverythingExcept


def run_cell(cell: Cell, diagnosis: str) -> dict[str, Any]:
    """Return the row of a cell.

    A row has `error` if the diagnosis failed, and `unmade` if the drive of no seed shows the hidden effects.
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
            row["truth"] = logs.write_log(cell, Path(folder))
        except ValueError as error:
            return {**row, "unmade": str(error)}
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            row["result"] = diagnose(Path(folder), frozenset())
            row["seconds"] = round(time.perf_counter() - wall, 2)
            row["cpu_seconds"] = round(time.process_time() - cpu, 2)
            row |= _compare_diagnoses(cell, diagnose, Path(folder), row["result"])
        except Exception:  # noqa: BLE001 (a failed diagnosis is counted and does not end the run)
            row["error"] = traceback.format_exc(limit=-4)
    return row


def _compare_diagnoses(
    cell: Cell, diagnose: Diagnosis, folder: Path, result: dict[str, Any]
) -> dict[str, Any]:
    """Return comparisons for singles and controls: searches with only the true name or a wrong one."""
    if cell.table not in ("singles", "controls") or not cell.hidden:
        return {}
    name = cell.hidden[0][0]
    comparisons = {"oracle": _diagnose_with_one_name(diagnose, folder, name)}
    if cell.table == "singles":
        return comparisons
    runner_up = _runner_up(result, name)
    others = [other for other in KINDS if other not in (name, runner_up)]
    random = others[sum(cell.seeds) % len(others)]
    comparisons["runner_up"] = {"name": runner_up, **_diagnose_with_one_name(diagnose, folder, runner_up)}
    comparisons["random"] = {"name": random, **_diagnose_with_one_name(diagnose, folder, random)}
    if name == "gyro_temperature":
        permuted_result = diagnose(folder / "permuted", frozenset())
        comparisons["permuted"] = {"found": [finding["effect"] for finding in permuted_result["found"]]}
    if diagnose is DIAGNOSES["gap"]:
        comparisons["black_box"] = black_box.compute_held_out_gaps(folder)
    return comparisons


def _runner_up(result: dict[str, Any], truth: str) -> str:
    """Return the most probable wrong name: the first one found, or the runner-up."""
    for finding in result["found"]:
        if finding["effect"] != truth and finding["effect"] in KINDS:
            return str(finding["effect"])
        if finding["runner_up"] and finding["runner_up"]["effect"] in KINDS:
            return str(finding["runner_up"]["effect"])
    return next(name for name in KINDS if name != truth)


def _diagnose_with_one_name(diagnose: Diagnosis, folder: Path, name: str) -> dict[str, Any]:
    """Return the held-out gap and the findings if only one name is permitted."""
    result = diagnose(folder, EverythingExcept([name]))
    return {"held_out_gap": result["held_out_gap"], "found": [it["effect"] for it in result["found"]]}
