"""Run of one trial: simulate the log, run `gap` in this process, and return the result as a row."""

from __future__ import annotations

import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from gap_matrix.judge.resumed import Row
from gap_matrix.judge.trials import Trial, draw_trial
from hubodo.gap.explain.result import Finding
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model


def judge_trial(item: tuple[int, str]) -> Row:
    """Return the row of a trial (seed, kind); it has `error` if the diagnosis failed."""
    seed, kind = item
    start_time = time.process_time()
    trial = draw_trial(seed, kind)
    row: Row = {"key": f"{kind}/{seed}", "kind": kind, "seed": seed, "words": trial.description}
    row["hidden"] = [
        {"name": effect.name, "scope": effect.scope, "nats": trial.meter.gain(effect)}
        for effect in trial.hidden
    ]
    row["seconds"] = trial.setup.drive.duration
    with tempfile.TemporaryDirectory(prefix="gap_trial_") as folder:
        trial.write(Path(folder))
        row["made_cpu"] = round(time.process_time() - start_time, 3)
        start_time = time.process_time()
        try:
            result = find_gap(read_folder(Path(folder)), read_model(Path(folder) / "model.toml"))
        except Exception:  # noqa: BLE001 (a failed diagnosis is counted and does not end the run)
            return {**row, "error": traceback.format_exc(limit=-4)}
    row["cpu"] = round(time.process_time() - start_time, 3)
    row["verdict"] = result.verdict
    row["found"] = [_describe_finding(trial, finding) for finding in result.found]
    return row


def _describe_finding(trial: Trial, finding: Finding) -> dict[str, Any]:
    """Return a finding as part of a row; `lost` is the advantage of the true scope over the stated one."""
    hidden = next((effect for effect in trial.hidden if effect.name == finding.effect), None)
    return {
        "name": finding.effect,
        "scope": finding.scope,
        "confidence": finding.confidence,
        "p_value": finding.p_value,
        "lost": None if hidden is None else trial.scope_advantage(hidden, finding.scope),
        "alike": list(finding.inseparable_from),
        "rivals": [list(alternative) for alternative in finding.rivals[:12]],
    }
