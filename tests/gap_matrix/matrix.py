"""The matrix of hidden effects: make logs, diagnose them, print what was named.

    python tests/gap_matrix/matrix.py [--tables singles,nulls,pairs,open,alike,controls] [--seeds test] ...

Results are appended to a file of JSON lines, by seeds and by the sources they came from; a run that was
interrupted goes on where it was. The test seeds are for the last run only: nothing may be tuned on them.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The package is found from its parent; this folder itself must not stand on the path, or its names would.
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from gap_matrix import effects, outside
from gap_matrix.dose import STRENGTHS
from gap_matrix.judge import lines, tables
from gap_matrix.judge.cells import PAIR_LIST_SEED, SEEDS, TABLES, Wanted, cells
from gap_matrix.judge.diagnoses import DIAGNOSES, fingerprint
from gap_matrix.judge.resumed import Row, kept, rows
from gap_matrix.judge.run import run


def main(argv: list[str] | None = None) -> int:
    """Run the missing cells and print the tables."""
    args = _arguments(argv)
    wanted = Wanted(
        tables=args.tables,
        seeds=args.seeds,
        names=args.effects,
        strengths=args.strengths,
        drives=args.drives,
        nulls=args.nulls,
        pairs=args.pairs,
    )
    path = args.out / f"{args.seeds}-{args.diagnosis}-{fingerprint()}.jsonl"
    plan = cells(wanted)
    first, known = SEEDS[args.seeds][0], {row["key"] for row in kept(path)}
    print(
        f"{len(plan)} cells, {args.seeds} seeds {first}..{first + len(SEEDS[args.seeds]) - 1}, pair list "
        f"seed {PAIR_LIST_SEED}; {sum(cell.key in known for cell in plan)} in {path}"
    )
    begin = time.monotonic()

    def say(done: int, of: int, row: Row) -> None:
        if args.progress:
            print(f"{done}/{of} {time.monotonic() - begin:.0f} s {lines.line(row)}", flush=True)

    judged = partial(run, diagnosis=args.diagnosis)
    made = rows(path, plan, lambda cell: cell.key, judged, args.jobs, say)
    for text in tables.all_tables(made):
        print(f"\n{text}")
    if args.failures:
        print(f"\n{lines.failures(made)}")
    return 0


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [*effects.KINDS, *outside.KINDS]
    parser.add_argument("--tables", type=_of(TABLES), default=list(TABLES), help=", ".join(TABLES))
    parser.add_argument("--seeds", choices=list(SEEDS), default="development")
    parser.add_argument(
        "--effects", type=_of(names), default=[], help="only these, of the vocabulary or outside"
    )
    parser.add_argument(
        "--strengths", type=_of(STRENGTHS), default=list(STRENGTHS), help=", ".join(STRENGTHS)
    )
    parser.add_argument("--drives", type=int, default=5, help="per cell")
    parser.add_argument("--nulls", type=int, default=200)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--diagnosis", choices=list(DIAGNOSES), default="gap", help="who is judged")
    parser.add_argument("--progress", action="store_true", help="a line for each cell")
    parser.add_argument("--failures", action="store_true", help="each failure in detail, after the tables")
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/gap-matrix"))
    return parser.parse_args(argv)


def _of(known: Iterable[str]):
    known = list(known)

    def chosen(text: str) -> list[str]:
        given = text.split(",")
        unknown = [name for name in given if name not in known]
        if unknown:
            raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: not one of {', '.join(known)}")
        return given

    return chosen


if __name__ == "__main__":
    sys.exit(main())
