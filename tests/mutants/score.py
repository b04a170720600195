"""Mutation testing of the core: small mistakes put into it one at a time, and whether a test notices.

    python tests/mutants/score.py [--seed 1] [--count 125] [--only fuse gap] [--budget 120] [--jobs 2]

Of all places of the core `--count` are drawn by the seed. For each, the tests that execute the changed line
run, cheapest first, in a copy of the project, until one fails or the budget is spent: what nobody noticed
until then has survived. The budget is seconds of processor time, so that a busy computer does not change the
score. Which test executes which line is recorded at first; that and the verdicts are kept in `out/mutants`
for as long as they hold, so that a run that was interrupted goes on. What waits for the clock is left out.
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

from gap_matrix.judge.resumed import Row, kept, rows  # noqa: E402
from mutants.core import CORE, digest  # noqa: E402
from mutants.equivalent import is_equivalent  # noqa: E402
from mutants.executed import Executed, recorded  # noqa: E402
from mutants.judge import Judge  # noqa: E402
from mutants.operators import Mutant, mutants  # noqa: E402
from mutants.project_copy import ProjectCopy  # noqa: E402
from mutants.reach import nearest_tests  # noqa: E402

KEPT = ROOT / "out" / "mutants"
_EXECUTED, _VERDICTS = KEPT / "executed.jsonl", KEPT / "verdicts.jsonl"


def main() -> int:
    """Draws the mutants, judges them, prints the survivors and the score."""
    args = _arguments()
    files = [
        str(path.relative_to(ROOT))
        for name in args.only or CORE
        for path in sorted((ROOT / CORE[name]).rglob("*.py"))
    ]
    every = [mutant for path in files for mutant in mutants(path, (ROOT / path).read_text("utf-8"))]
    drawn = random.Random(args.seed).sample(every, min(args.count, len(every)))
    plan = [mutant for mutant in drawn if not is_equivalent(mutant, _line(mutant))]
    print(f"{len(drawn)} of {len(every)} mutants in {len(files)} files, seed {args.seed}", flush=True)
    reach = nearest_tests(ROOT, {mutant.path for mutant in plan})
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tests = sorted({file for nearest in reach.values() for file in nearest})
        recorded(_EXECUTED, tests, partial(_copy, folder), _say_recorded)
        _forget_what_changed(plan, reach)
        judge = partial(_judged, folder=folder, reach=reach, budget=args.budget)
        verdicts = rows(_VERDICTS, plan, _key, judge, args.jobs, _say)
        unfair = _judge(folder).fail_anyhow({row["killed_by"] for row in verdicts} - {""})
    for test in unfair:
        print(f"{test} fails without any mutant: what it killed has survived")
    spared = {"", *unfair}
    survived = [mutant for mutant, row in zip(plan, verdicts, strict=True) if row["killed_by"] in spared]
    print("\nSurvived:" if survived else "\nNone survived.")
    for mutant in sorted(survived, key=str):
        print(f"  {mutant}")
    share = 1.0 - len(survived) / max(len(plan), 1)
    print(
        f"killed {len(plan) - len(survived)} of {len(plan)}, {share:.0%}; seed {args.seed}; "
        f"{len(drawn) - len(plan)} more change nothing"
    )
    return int(share < args.demand)


def _line(mutant: Mutant) -> str:
    return (ROOT / mutant.path).read_text("utf-8").splitlines()[mutant.line - 1]


def _key(mutant: Mutant) -> str:
    return f"{mutant} at {mutant.start} of {digest(ROOT / mutant.path)}"


def _hangs_on(killed_by: str, nearest: Sequence[str]) -> str:
    """Of the test file that killed a mutant; of all that might, where none did."""
    files = [killed_by.partition("::")[0]] if "::" in killed_by else nearest
    return hashlib.sha256("".join(digest(ROOT / file) for file in files).encode()).hexdigest()[:16]


def _forget_what_changed(plan: Sequence[Mutant], reach: dict[str, list[str]]) -> None:
    """Verdicts of tests that are no longer the same."""
    nearest = {_key(mutant): reach[mutant.path] for mutant in plan}
    hold = [
        row
        for row in kept(_VERDICTS)
        if row["key"] not in nearest or row["hangs_on"] == _hangs_on(row["killed_by"], nearest[row["key"]])
    ]
    _VERDICTS.write_text("".join(json.dumps(row) + "\n" for row in hold), "utf-8")


@cache
def _copy(folder: str) -> ProjectCopy:
    """One for each process."""
    return ProjectCopy(Path(folder) / str(os.getpid()))


@cache
def _judge(folder: str) -> Judge:
    return Judge(_copy(folder), Executed(kept(_EXECUTED)))


def _judged(mutant: Mutant, folder: str, reach: dict[str, list[str]], budget: float) -> Row:
    nearest = reach[mutant.path]
    verdict = _judge(folder).judge(mutant, nearest, budget)
    return {
        "key": _key(mutant),
        "mutant": str(mutant),
        "killed_by": verdict.killed_by,
        "seconds": round(verdict.seconds, 1),
        "hangs_on": _hangs_on(verdict.killed_by, nearest),
    }


def _say(done: int, of: int, row: Row) -> None:
    told = f"killed by {row['killed_by']}" if row["killed_by"] else "SURVIVED"
    print(f"{done} of {of}: {row['seconds']:6.1f} s  {row['mutant']}  {told}", flush=True)


def _say_recorded(done: int, of: int) -> None:
    print(f"recorded what {done} of {of} test files execute", flush=True)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=125)
    parser.add_argument("--only", nargs="+", choices=list(CORE), help="these rooms")
    parser.add_argument(
        "--budget", type=float, default=120.0, help="processor seconds of tests for one mutant"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--demand", type=float, default=0.0, help="share that must be killed, else exit code 1"
    )
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
