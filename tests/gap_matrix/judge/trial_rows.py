"""Trials from start to end: make the log, run `gap` in this process, return the answer as a row."""

from __future__ import annotations

import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from gap_matrix.judge.resumed import Row
from gap_matrix.judge.trials import Trial, trial
from hubodo.gap.explain.result import Finding
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model


def judged(item: tuple[int, str]) -> Row:
    """Return the row of a trial; a diagnosis that fails gives a row with `error`."""
    seed, kind = item
    begin = time.process_time()
    made = trial(seed, kind)
    row: Row = {"key": f"{kind}/{seed}", "kind": kind, "seed": seed, "words": made.words}
    row["hidden"] = [{"name": it.name, "scope": it.scope, "nats": made.meter.gain(it)} for it in made.hidden]
    row["seconds"] = made.setup.drive.duration
    with tempfile.TemporaryDirectory(prefix="gap_trial_") as folder:
        made.write(Path(folder))
        row["made_cpu"] = round(time.process_time() - begin, 3)
        begin = time.process_time()
        try:
            result = find_gap(read_folder(Path(folder)), read_model(Path(folder) / "model.toml"))
        except Exception:  # noqa: BLE001 (a diagnosis that breaks is a failure to be counted, not the end)
            return {**row, "error": traceback.format_exc(limit=-4)}
    row["cpu"] = round(time.process_time() - begin, 3)
    row["verdict"] = result.verdict
    row["found"] = [_found(made, it) for it in result.found]
    return row


def _found(made: Trial, it: Finding) -> dict[str, Any]:
    hidden = next((one for one in made.hidden if one.name == it.effect), None)
    return {
        "name": it.effect,
        "scope": it.scope,
        "confidence": it.confidence,
        "p_value": it.p_value,
        "lost": None if hidden is None else made.lost(hidden, it.scope),
        "alike": list(it.inseparable_from),
        "rivals": [list(rival) for rival in it.rivals[:12]],
    }
