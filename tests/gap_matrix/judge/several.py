"""Three to five effects hidden at once: names found, false names, and dependence on the order.

    python tests/gap_matrix/judge/several.py [--sets 40] [--orders 5] [--seeds test]

Each is hidden at a size between medium and strong. Of the first sets the search is done again with each name
that was found, and one that was not, forced to be the first: the same names have to be left at the end.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The package is found from its parent; this folder itself must not stand on the path, or its names would.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

from gap_matrix.judge.diagnoses import fingerprint
from gap_matrix.judge.reliability import FIRST, right
from gap_matrix.judge.resumed import Row, rows
from gap_matrix.judge.tables import share
from gap_matrix.judge.trial_rows import judged
from gap_matrix.judge.trials import trial
from hubodo.gap.judge.reconsider import drop_chance_effects, reconsider_effects
from hubodo.gap.judge.search import build_initial_state, search_effects
from hubodo.gap.problem.build import build_problem
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# Not those of single names: these sets begin elsewhere.
_BEGIN = 10_000
Names = frozenset[tuple[str, str]]
"""Effects with their scopes."""


def named_from(folder: Path, first: str | None = None) -> Names:
    """Return the names at the end of a search; `first`: a name added first, which may be removed again."""
    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    found = search_effects(build_initial_state(problem), [] if first is None else [first])
    last, _ = drop_chance_effects(*reconsider_effects(found))
    return frozenset(term.key for term in last.final.state.terms if term.is_fitted)


def orders(seed: int, kind: str = "several", stranger: str = "accel_bias") -> dict[str, Names]:
    """Return the final names by the name that was added first."""
    with tempfile.TemporaryDirectory(prefix="gap_orders_") as folder:
        trial(seed, kind).write(Path(folder))
        made = {"as it comes": named_from(Path(folder))}
        for name in sorted({name for name, _ in made["as it comes"]} | {stranger}):
            made[name] = named_from(Path(folder), name)
    return made


def ordered(seed: int) -> Row:
    """Return the row of a set in all orders."""
    made = {first: sorted(map(list, names)) for first, names in orders(seed).items()}
    return {"key": f"orders/{seed}", "seed": seed, "orders": made}


def told(made: Sequence[Row]) -> str:
    """Return the table of all sets."""
    whole = [row for row in made if "error" not in row]
    hits, false, sure, exact, lines = [], 0, 0, [], []
    for row in whole:
        given = {it["name"] for it in row["found"]}
        hidden = {it["name"]: it for it in row["hidden"]}
        hits += [name in given for name in hidden]
        strange = [it for it in row["found"] if it["name"] not in hidden]
        elsewhere = [it for it in row["found"] if it["name"] in hidden and not right(it)]
        false += len(strange)
        sure += sum(it["confidence"] > 0.5 for it in strange)
        exact.append(given == set(hidden))
        if exact[-1] and not elsewhere:
            continue
        missed = [
            f"-{it['name']} {it['scope']} {it['nats']:.0f}" for n, it in hidden.items() if n not in given
        ]
        more = [f"+{it['name']} {it['scope']} {it['confidence']:.2f}" for it in (*strange, *elsewhere)]
        lines.append(f"  {row['key']} of {', '.join(hidden)}: {', '.join([*missed, *more])}")
    cpu = sum(row["cpu"] for row in whole) / max(len(whole), 1)
    return "\n".join(
        [
            f"{len(made)} sets, {len(made) - len(whole)} broken (95 % intervals, exact)",
            f"  hidden names that are named   {share(hits)}",
            f"  names that are not hidden     {false}: {false / max(len(whole), 1):.3f} a set",
            f"  of these, confidence above 0.5 {sure}",
            f"  all named and nothing else    {share(exact)}",
            f"  processor a set               {cpu:.2f} s",
            *lines,
        ]
    )


def told_orders(made: Sequence[Row]) -> str:
    """Return the number of sets whose result does not depend on the order, and the others in detail."""
    out, same = [], []
    for row in made:
        usual = row["orders"]["as it comes"]
        other = {first: names for first, names in row["orders"].items() if names != usual}
        same.append(not other)
        for first, names in other.items():
            gone = [" ".join(it) for it in usual if it not in names]
            come = [" ".join(it) for it in names if it not in usual]
            out.append(f"  {row['seed']}, {first} first: -{gone} +{come}")
    return "\n".join([f"the same names whichever comes first: {share(same)} sets", *out])


def main(argv: list[str] | None = None) -> int:
    """Judge the missing sets and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument("--orders", type=int, default=5, help="sets that are searched in all orders")
    parser.add_argument("--seeds", choices=list(FIRST), default="development")
    parser.add_argument("--jobs", type=int, default=2, choices=(1, 2), help="processes")
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/gap-several"))
    args = parser.parse_args(argv)
    first = FIRST[args.seeds] + _BEGIN
    path = args.out / f"{args.seeds}-{fingerprint()}.jsonl"
    print(
        f"{args.sets} sets, {args.seeds} seeds {first}..{first + args.sets - 1}; rows in {path}", flush=True
    )
    plan = [(first + k, "several") for k in range(args.sets)]
    print(told(rows(path, plan, lambda item: f"{item[1]}/{item[0]}", judged, args.jobs)), flush=True)
    if args.orders:
        some = [seed for seed, _ in plan[: args.orders]]
        print(told_orders(rows(path, some, lambda seed: f"orders/{seed}", ordered, args.jobs)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
