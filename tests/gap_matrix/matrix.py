"""The matrix of hidden effects: write logs, diagnose them and print tables of the effects found.

    python tests/gap_matrix/matrix.py [--tables singles,nulls,pairs,open,alike,controls] [--seeds test] ...

Results are appended to a file of JSON lines per seed range and source fingerprint, so that an interrupted run
continues. The test seeds are for the final run only: nothing may be tuned on them.
"""

# ruff: noqa: E402 (the number of BLAS threads is set before numpy is imported)

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# gap_matrix is imported from its parent folder; with this folder on the path, its modules would shadow
# others.
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from gap_matrix import effects, outside
from gap_matrix.dose import STRENGTHS
from gap_matrix.judge import lines, tables
from gap_matrix.judge.cells import PAIR_LIST_SEED, SEED_RANGES, TABLES, TableExtent, list_cells
from gap_matrix.judge.diagnoses import DIAGNOSES, compute_fingerprint
from gap_matrix.judge.resumed import Row, compute_rows, read_rows
from gap_matrix.judge.run import run_cell


def main(argv: list[str] | None = None) -> int:
    """Run the missing cells and print the tables."""
    args = _parse_arguments(argv)
    extent = TableExtent(
        tables=args.tables,
        seeds=args.seeds,
        names=args.effects,
        strengths=args.strengths,
        n_drives=args.drives,
        n_nulls=args.nulls,
        n_pairs=args.pairs,
    )
    path = args.out / f"{args.seeds}-{args.diagnosis}-{compute_fingerprint()}.jsonl"
    plan = list_cells(extent)
    first, finished_keys = SEED_RANGES[args.seeds][0], {row["key"] for row in read_rows(path)}
    print(
        f"{len(plan)} cells, {args.seeds} seeds {first}..{first + len(SEED_RANGES[args.seeds]) - 1}, "
        f"pair list seed {PAIR_LIST_SEED}; {sum(cell.key in finished_keys for cell in plan)} in {path}"
    )
    start_time = time.monotonic()

    def report_progress(done: int, total: int, row: Row) -> None:
        if args.progress:
            print(f"{done}/{total} {time.monotonic() - start_time:.0f} s {lines.format_row(row)}", flush=True)

    run_one = partial(run_cell, diagnosis=args.diagnosis)
    result_rows = compute_rows(path, plan, lambda cell: cell.key, run_one, args.jobs, report_progress)
    for text in tables.format_tables(result_rows):
        print(f"\n{text}")
    if args.failures:
        print(f"\n{lines.format_failures(result_rows)}")
    return 0


def _parse_arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [*effects.KINDS, *outside.KINDS]
    parser.add_argument("--tables", type=_list_parser(TABLES), default=list(TABLES), help=", ".join(TABLES))
    parser.add_argument("--seeds", choices=list(SEED_RANGES), default="development")
    parser.add_argument(
        "--effects",
        type=_list_parser(names),
        default=[],
        help="only these, inside or outside the vocabulary; default all",
    )
    parser.add_argument(
        "--strengths", type=_list_parser(STRENGTHS), default=list(STRENGTHS), help=", ".join(STRENGTHS)
    )
    parser.add_argument("--drives", type=int, default=5, help="drives per cell")
    parser.add_argument("--nulls", type=int, default=200)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--diagnosis", choices=list(DIAGNOSES), default="gap", help="the diagnosis to score")
    parser.add_argument("--progress", action="store_true", help="print a line for each cell")
    parser.add_argument(
        "--failures", action="store_true", help="print each failure in detail after the tables"
    )
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/gap-matrix"))
    return parser.parse_args(argv)


def _list_parser(names: Iterable[str]):
    """Return a parser of a comma-separated list that allows only these names."""
    permitted = list(names)

    def parse_list(text: str) -> list[str]:
        requested = text.split(",")
        unknown = [name for name in requested if name not in permitted]
        if unknown:
            raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: not one of {', '.join(permitted)}")
        return requested

    return parse_list


if __name__ == "__main__":
    sys.exit(main())
