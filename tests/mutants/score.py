"""Mutation testing of the core: mutants are applied one at a time, and a test has to fail.

    python tests/mutants/score.py [--seed 1] [--count 125] [--only fuse gap] [--budget 120] [--jobs 2]

`--count` mutants of all mutants of the core are sampled by the seed. For each, the tests that execute the
changed line are run in a copy of the project, fastest first, until one fails or the budget is exceeded; then
the mutant has survived. The budget is CPU time, so that the load of the computer does not change the score.
The lines executed by each test are recorded first. Records and verdicts are stored in `out/mutants` as long
as their files are unchanged, so that an interrupted run continues. Tests marked `real_time` are excluded.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import sys
import tempfile
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests")]

from gap_matrix.judge.resumed import Row, compute_rows, read_rows  # noqa: E402
from mutants.core import CORE, digest  # noqa: E402
from mutants.equivalent import is_equivalent  # noqa: E402
from mutants.executed import LineCoverage, record_coverage  # noqa: E402
from mutants.judge import Judge  # noqa: E402
from mutants.operators import Mutant, list_mutants  # noqa: E402
from mutants.project_copy import ProjectCopy  # noqa: E402
from mutants.reach import nearest_tests  # noqa: E402
from script_arguments import script_parser  # noqa: E402

OUTPUT_FOLDER = ROOT / "out" / "mutants"
_COVERAGE_PATH, _VERDICT_PATH = OUTPUT_FOLDER / "executed.jsonl", OUTPUT_FOLDER / "verdicts.jsonl"


def main() -> int:
    """Sample the mutants, judge them, and print the survivors and the score."""
    args = _parse_arguments()
    files = [
        str(path.relative_to(ROOT))
        for name in args.only or CORE
        for path in sorted((ROOT / CORE[name]).rglob("*.py"))
    ]
    all_mutants = [
        mutant for path in files for mutant in list_mutants(path, (ROOT / path).read_text("utf-8"))
    ]
    sample = random.Random(args.seed).sample(all_mutants, min(args.count, len(all_mutants)))
    mutants_to_judge = [mutant for mutant in sample if not is_equivalent(mutant, _read_line(mutant))]
    print(f"{len(sample)} of {len(all_mutants)} mutants in {len(files)} files, seed {args.seed}", flush=True)
    reach = nearest_tests(ROOT, {mutant.path for mutant in mutants_to_judge})
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tests = sorted({file for nearest in reach.values() for file in nearest})
        record_coverage(_COVERAGE_PATH, tests, partial(_project_copy, folder), _report_recording)
        _drop_outdated_verdicts(mutants_to_judge, reach)
        judge = partial(_judge_mutant, folder=folder, reach=reach, budget=args.budget)
        verdicts = compute_rows(_VERDICT_PATH, mutants_to_judge, _key_of, judge, args.jobs, _report_verdict)
        failing_without_mutant = _build_judge(folder).find_failing_tests(
            {row["killed_by"] for row in verdicts} - {""}
        )
    for test in failing_without_mutant:
        print(f"{test} fails without a mutant: the mutants it killed count as survived")
    not_killing = {"", *failing_without_mutant}
    survived = [
        mutant
        for mutant, row in zip(mutants_to_judge, verdicts, strict=True)
        if row["killed_by"] in not_killing
    ]
    print("\nSurvived:" if survived else "\nNone survived.")
    for mutant in sorted(survived, key=str):
        print(f"  {mutant}")
    share = 1.0 - len(survived) / max(len(mutants_to_judge), 1)
    print(
        f"killed {len(mutants_to_judge) - len(survived)} of {len(mutants_to_judge)}, {share:.0%}; "
        f"seed {args.seed}; {len(sample) - len(mutants_to_judge)} more are equivalent"
    )
    return int(share < args.demand)


def _read_line(mutant: Mutant) -> str:
    """Return the source line of a mutant."""
    return (ROOT / mutant.path).read_text("utf-8").splitlines()[mutant.line - 1]


def _key_of(mutant: Mutant) -> str:
    """Return the key of a verdict; it changes with the source file."""
    return f"{mutant} at {mutant.start} of {digest(ROOT / mutant.path)}"


def _digest_of_dependencies(killed_by: str, nearest: Sequence[str]) -> str:
    """Return a digest of the test file that killed a mutant, or of all nearest ones if none did."""
    files = [killed_by.partition("::")[0]] if "::" in killed_by else nearest
    return hashlib.sha256("".join(digest(ROOT / file) for file in files).encode()).hexdigest()[:16]


def _drop_outdated_verdicts(mutants_to_judge: Sequence[Mutant], reach: dict[str, list[str]]) -> None:
    """Remove verdicts of test files that have changed since."""
    nearest = {_key_of(mutant): reach[mutant.path] for mutant in mutants_to_judge}
    current_rows = [
        row
        for row in read_rows(_VERDICT_PATH)
        if row["key"] not in nearest
        or row["hangs_on"] == _digest_of_dependencies(row["killed_by"], nearest[row["key"]])
    ]
    _VERDICT_PATH.write_text("".join(json.dumps(row) + "\n" for row in current_rows), "utf-8")


@cache
def _project_copy(folder: str) -> ProjectCopy:
    """Return the copy of the project of this process."""
    return ProjectCopy(Path(folder) / str(os.getpid()))


@cache
def _build_judge(folder: str) -> Judge:
    """Return the judge of this process."""
    return Judge(_project_copy(folder), LineCoverage(read_rows(_COVERAGE_PATH)))


def _judge_mutant(mutant: Mutant, folder: str, reach: dict[str, list[str]], budget: float) -> Row:
    """Return the verdict on a mutant as a row."""
    nearest = reach[mutant.path]
    verdict = _build_judge(folder).judge(mutant, nearest, budget)
    return {
        "key": _key_of(mutant),
        "mutant": str(mutant),
        "killed_by": verdict.killed_by,
        "seconds": round(verdict.seconds, 1),
        "hangs_on": _digest_of_dependencies(verdict.killed_by, nearest),
    }


def _report_verdict(done: int, total: int, row: Row) -> None:
    outcome = f"killed by {row['killed_by']}" if row["killed_by"] else "SURVIVED"
    print(f"{done} of {total}: {row['seconds']:6.1f} s  {row['mutant']}  {outcome}", flush=True)


def _report_recording(done: int, total: int) -> None:
    print(f"recorded the executed lines of {done} of {total} test files", flush=True)


def _parse_arguments() -> argparse.Namespace:
    parser = script_parser(__doc__, seed=1, count=125)
    parser.add_argument("--only", nargs="+", choices=list(CORE), help="only these folders of the core")
    parser.add_argument("--budget", type=float, default=120.0, help="CPU time of tests per mutant, s")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--demand",
        type=float,
        default=0.0,
        help="smallest share of killed mutants; below it the exit code is 1",
    )
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
