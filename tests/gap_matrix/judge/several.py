"""Three to five effects hidden at once: effects found, false names, and dependence on the search order.

    python tests/gap_matrix/judge/several.py [--sets 40] [--orders 5] [--seeds test]

Each effect has a size between medium and strong. For the first sets the search is repeated with each found
effect, and with an absent one, forced to be added first; the final effects must be the same.
"""

# ruff: noqa: E402 (the number of BLAS threads is set before numpy is imported)

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# gap_matrix is imported from the folder above it; with its own folder on the path, its modules shadow others.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

from gap_matrix.judge.diagnoses import compute_fingerprint
from gap_matrix.judge.reliability import FIRST_SEED, is_correct
from gap_matrix.judge.resumed import Row, compute_rows
from gap_matrix.judge.tables import format_share
from gap_matrix.judge.trial_rows import judge_trial
from gap_matrix.judge.trials import draw_trial
from hubodo.gap.judge.chance_effects import drop_chance_effects
from hubodo.gap.judge.reconsider import reconsider_effects
from hubodo.gap.judge.search import build_initial_state, search_effects
from hubodo.gap.problem.build import build_problem
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# Offset of the seeds, so that the sets differ from the trials of single effects.
_FIRST_SET_OFFSET = 10_000
ScopedNames = frozenset[tuple[str, str]]
"""Effects with their scopes."""


def search_names(folder: Path, first: str | None = None) -> ScopedNames:
    """Return the effects at the end of a search.

    first: an effect that is added first; the search may remove it again
    """
    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    result = search_effects(build_initial_state(problem), [] if first is None else [first])
    reduced, _ = drop_chance_effects(*reconsider_effects(result))
    return frozenset(term.key for term in reduced.final.state.terms if term.is_fitted)


def search_in_all_orders(
    seed: int, kind: str = "several", absent_effect: str = "accel_bias"
) -> dict[str, ScopedNames]:
    """Return the final effects by the effect that was added first."""
    with tempfile.TemporaryDirectory(prefix="gap_orders_") as folder:
        draw_trial(seed, kind).write(Path(folder))
        result_rows = {"as it comes": search_names(Path(folder))}
        for name in sorted({name for name, _ in result_rows["as it comes"]} | {absent_effect}):
            result_rows[name] = search_names(Path(folder), name)
    return result_rows


def compute_order_row(seed: int) -> Row:
    """Return the row of a set of effects in all orders."""
    result_rows = {first: sorted(map(list, names)) for first, names in search_in_all_orders(seed).items()}
    return {"key": f"orders/{seed}", "seed": seed, "orders": result_rows}


def format_table(result_rows: Sequence[Row]) -> str:
    """Return the table of all sets."""
    valid_rows = [row for row in result_rows if "error" not in row]
    is_found, n_false, n_false_confident, is_exact, detail_lines = [], 0, 0, [], []
    for row in valid_rows:
        found_names = {finding["name"] for finding in row["found"]}
        hidden = {finding["name"]: finding for finding in row["hidden"]}
        is_found += [name in found_names for name in hidden]
        false_findings = [finding for finding in row["found"] if finding["name"] not in hidden]
        wrong_scope = [
            finding for finding in row["found"] if finding["name"] in hidden and not is_correct(finding)
        ]
        n_false += len(false_findings)
        n_false_confident += sum(finding["confidence"] > 0.5 for finding in false_findings)
        is_exact.append(found_names == set(hidden))
        if is_exact[-1] and not wrong_scope:
            continue
        missed = [
            f"-{finding['name']} {finding['scope']} {finding['nats']:.0f}"
            for name, finding in hidden.items()
            if name not in found_names
        ]
        extra = [
            f"+{finding['name']} {finding['scope']} {finding['confidence']:.2f}"
            for finding in (*false_findings, *wrong_scope)
        ]
        detail_lines.append(f"  {row['key']} of {', '.join(hidden)}: {', '.join([*missed, *extra])}")
    seconds_per_set = sum(row["cpu"] for row in valid_rows) / max(len(valid_rows), 1)
    return "\n".join(
        [
            f"{len(result_rows)} sets, {len(result_rows) - len(valid_rows)} failed (95 % intervals, exact)",
            f"  hidden effects found          {format_share(is_found)}",
            f"  false names                   {n_false}: {n_false / max(len(valid_rows), 1):.3f} per set",
            f"  of these, confidence > 0.5    {n_false_confident}",
            f"  all found and nothing else    {format_share(is_exact)}",
            f"  CPU time per set              {seconds_per_set:.2f} s",
            *detail_lines,
        ]
    )


def format_order_table(result_rows: Sequence[Row]) -> str:
    """Return the share of sets whose result does not depend on the order, and the others in detail."""
    lines, is_same = [], []
    for row in result_rows:
        default = row["orders"]["as it comes"]
        differing = {first: names for first, names in row["orders"].items() if names != default}
        is_same.append(not differing)
        for first, names in differing.items():
            missing = [" ".join(finding) for finding in default if finding not in names]
            added = [" ".join(finding) for finding in names if finding not in default]
            lines.append(f"  {row['seed']}, {first} first: -{missing} +{added}")
    return "\n".join([f"the same effects in every order: {format_share(is_same)} sets", *lines])


def main(argv: list[str] | None = None) -> int:
    """Judge the missing sets and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument(
        "--orders", type=int, default=5, help="number of sets that are searched in all orders"
    )
    parser.add_argument("--seeds", choices=list(FIRST_SEED), default="development")
    parser.add_argument("--jobs", type=int, default=2, choices=(1, 2), help="processes")
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/gap-several"))
    args = parser.parse_args(argv)
    first = FIRST_SEED[args.seeds] + _FIRST_SET_OFFSET
    path = args.out / f"{args.seeds}-{compute_fingerprint()}.jsonl"
    print(
        f"{args.sets} sets, {args.seeds} seeds {first}..{first + args.sets - 1}; rows in {path}", flush=True
    )
    plan = [(first + k, "several") for k in range(args.sets)]
    print(
        format_table(compute_rows(path, plan, lambda item: f"{item[1]}/{item[0]}", judge_trial, args.jobs)),
        flush=True,
    )
    if args.orders:
        ordered_seeds = [seed for seed, _ in plan[: args.orders]]
        print(
            format_order_table(
                compute_rows(path, ordered_seeds, lambda seed: f"orders/{seed}", compute_order_row, args.jobs)
            )
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
