"""Reliability of stated confidences: share of correct names by confidence in thousands of short logs.

    python tests/gap_matrix/judge/reliability.py [--cases 2000] [--seeds test] [--kinds single,blunt]

A name is correct if it is hidden, in the stated scope if the drive distinguishes the scopes by more than 3
nats. Rows are stored per seed range and source fingerprint, so that an interrupted run continues. The test
seeds are for the final run only: nothing may be tuned on them.
"""

# ruff: noqa: E402 (the number of BLAS threads is set before numpy is imported)

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# gap_matrix is imported from the folder above it; with its own folder on the path, its modules shadow others.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

from gap_matrix.judge.calibration import GivenName, bin_names, draw_diagram
from gap_matrix.judge.diagnoses import compute_fingerprint
from gap_matrix.judge.resumed import Row, compute_rows
from gap_matrix.judge.trial_rows import judge_trial
from gap_matrix.judge.trials import KINDS, mix_kinds
from hubodo.effects.empirical import PREFIX

FIRST_SEED = {"development": 20_000, "test": 430_000}
# A drive distinguishes two scopes of an effect if its gain differs by more than this.
_MAX_SCOPE_ADVANTAGE_NATS = 3.0


def is_correct(finding: Mapping[str, Any]) -> bool:
    """Return True if a name is hidden, in the stated scope as far as the drive distinguishes scopes."""
    return finding["lost"] is not None and finding["lost"] < _MAX_SCOPE_ADVANTAGE_NATS


def list_given_names(result_rows: Sequence[Row]) -> list[GivenName]:
    """Return all names of the vocabulary in the rows, without empirical terms."""
    return [
        GivenName(finding["confidence"], is_correct(finding))
        for row in result_rows
        for finding in row.get("found", [])
        if not finding["name"].startswith(PREFIX)
    ]


def format_table(result_rows: Sequence[Row]) -> str:
    """Return the table of names by confidence, of all trials and by kind."""
    lines = [
        f"{len(result_rows)} logs, {sum('error' in row for row in result_rows)} failed; 90 % intervals, exact"
    ]
    for kind, kind_rows in [
        ("all", list(result_rows)),
        *((k, [r for r in result_rows if r["kind"] == k]) for k in KINDS),
    ]:
        if not kind_rows:
            continue
        names = list_given_names(kind_rows)
        n_hidden = sum(len(row["hidden"]) for row in kind_rows)
        n_correct = sum(finding.is_correct for finding in names)
        lines.append(
            f"{kind}: {len(kind_rows)} logs, {n_hidden} hidden, {len(names)} names given, {n_correct} correct"
        )
        lines += (
            [f"  {confidence_bin.describe()}" for confidence_bin in bin_names(names)]
            if kind == "all"
            else [f"  {_format_confident(names)}"]
        )
    seconds_per_log = sum(row.get("cpu", 0.0) for row in result_rows) / max(len(result_rows), 1)
    simulation_seconds = sum(row["made_cpu"] for row in result_rows) / max(len(result_rows), 1)
    lines.append(f"CPU time per log: {seconds_per_log:.2f} s, and {simulation_seconds:.2f} s to simulate it")
    return "\n".join(lines)


def _format_confident(names: Sequence[GivenName]) -> str:
    """Return the number of correct names with a confidence of at least 0.9."""
    confident = [finding for finding in names if finding.confidence >= 0.9]
    return f"at 0.9 and more: {sum(finding.is_correct for finding in confident)} of {len(confident)} correct"


def format_wrong_names(result_rows: Sequence[Row], min_confidence: float) -> str:
    """Return each wrong name with a confidence of at least `min_confidence`, one per line."""
    return "\n".join(
        f"{row['key']} ({row['words']}) hidden "
        + (
            ", ".join(f"{effect['name']} {effect['scope']} {effect['nats']:.0f}" for effect in row["hidden"])
            or "nothing"
        )
        + f" -> {finding['name']} {finding['scope']} {finding['confidence']:.4f} p {finding['p_value']:.1g}"
        + (f" = {'/'.join(finding['alike'])}" if finding["alike"] else "")
        + "".join(
            f"\n      {name} {scope} gain {gain:.1f} {probability:.2g}"
            for name, scope, gain, probability in finding["rivals"][:5]
        )
        for row in result_rows
        for finding in row.get("found", [])
        if not is_correct(finding)
        and finding["confidence"] >= min_confidence
        and not finding["name"].startswith(PREFIX)
    )


def main(argv: list[str] | None = None) -> int:
    """Judge the missing trials, print the table and draw the diagram."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seeds", choices=list(FIRST_SEED), default="development")
    parser.add_argument("--first", type=int, default=0, help="index of the first seed")
    parser.add_argument(
        "--kinds", type=lambda text: text.split(","), default=[], help=f"of {', '.join(KINDS)}"
    )
    parser.add_argument("--jobs", type=int, default=2, choices=(1, 2), help="processes")
    parser.add_argument("--wrong", type=float, help="list wrong names with at least this confidence")
    parser.add_argument("--figure", type=Path, help="file of the diagram; default beside the rows")
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/gap-reliability"))
    args = parser.parse_args(argv)
    first = FIRST_SEED[args.seeds] + args.first
    plan = [(first + k, kind) for k, kind in enumerate(mix_kinds(args.cases))]
    plan = [item for item in plan if not args.kinds or item[1] in args.kinds]
    path = args.out / f"{args.seeds}-{compute_fingerprint()}.jsonl"
    seed_text = f"seeds {first}..{first + args.cases - 1}"
    print(f"{len(plan)} logs, {args.seeds} {seed_text}; rows in {path}", flush=True)
    result_rows = compute_rows(path, plan, lambda item: f"{item[1]}/{item[0]}", judge_trial, args.jobs)
    print(format_table(result_rows))
    if args.wrong is not None:
        print(format_wrong_names(result_rows, args.wrong))
    names = list_given_names(result_rows)
    title = f"{len(names)} names in {len(result_rows)} logs, {seed_text}; 90 % intervals"
    draw_diagram(bin_names(names), title, args.figure or path.with_suffix(".svg"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
