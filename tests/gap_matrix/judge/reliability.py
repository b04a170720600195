"""Reliability of confidences: names in some thousand short logs, and the share that is correct.

    python tests/gap_matrix/judge/reliability.py [--cases 2000] [--seeds test] [--kinds single,blunt]

A name is right when it is hidden, on the node that it is said to be on wherever the drive tells that by more
than 3 nats. Rows are kept by seeds and sources; a run that was interrupted goes on. The test seeds are for
the last run only: nothing may be tuned on them.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The package is found from its parent; this folder itself must not stand on the path, or its names would.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

from gap_matrix.judge.calibration import Given, binned, diagram
from gap_matrix.judge.diagnoses import fingerprint
from gap_matrix.judge.resumed import Row, rows
from gap_matrix.judge.trial_rows import judged
from gap_matrix.judge.trials import KINDS, kinds
from hubodo.effects.empirical import PREFIX

FIRST = {"development": 20_000, "test": 430_000}
# Nats from which on a drive tells on which node an effect is.
_TOLD = 3.0


def right(found: Mapping[str, Any]) -> bool:
    """Return True if a name is hidden, in the scope that is given."""
    return found["lost"] is not None and found["lost"] < _TOLD


def given(made: Sequence[Row]) -> list[Given]:
    """Return all names of the vocabulary that were given."""
    return [
        Given(it["confidence"], right(it))
        for row in made
        for it in row.get("found", [])
        if not it["name"].startswith(PREFIX)
    ]


def told(made: Sequence[Row]) -> str:
    """Return the table of names by confidence, of all trials and by kind."""
    out = [f"{len(made)} logs, {sum('error' in row for row in made)} broken; 90 % intervals, exact"]
    for kind, here in [("all", list(made)), *((k, [r for r in made if r["kind"] == k]) for k in KINDS)]:
        if not here:
            continue
        names = given(here)
        hidden = sum(len(row["hidden"]) for row in here)
        hits = sum(it.right for it in names)
        out.append(f"{kind}: {len(here)} logs, {hidden} hidden, {len(names)} names given, {hits} right")
        out += [f"  {it.words}" for it in binned(names)] if kind == "all" else [f"  {_sure(names)}"]
    cpu = sum(row.get("cpu", 0.0) for row in made) / max(len(made), 1)
    making = sum(row["made_cpu"] for row in made) / max(len(made), 1)
    out.append(f"processor a log: {cpu:.2f} s, {making:.2f} s to make it")
    return "\n".join(out)


def _sure(names: Sequence[Given]) -> str:
    """Return in words how names above 0.9 fare, for one kind."""
    sure = [it for it in names if it.confidence >= 0.9]
    return f"at 0.9 and more: {sum(it.right for it in sure)} of {len(sure)} right"


def wrong(made: Sequence[Row], least: float) -> str:
    """Return each wrong name with a confidence above `least`, one per line."""
    return "\n".join(
        f"{row['key']} ({row['words']}) hidden "
        + (", ".join(f"{h['name']} {h['scope']} {h['nats']:.0f}" for h in row["hidden"]) or "nothing")
        + f" -> {it['name']} {it['scope']} {it['confidence']:.4f} p {it['p_value']:.1g}"
        + (f" = {'/'.join(it['alike'])}" if it["alike"] else "")
        + "".join(f"\n      {n} {s} gain {g:.1f} {p:.2g}" for n, s, g, p in it["rivals"][:5])
        for row in made
        for it in row.get("found", [])
        if not right(it) and it["confidence"] >= least and not it["name"].startswith(PREFIX)
    )


def main(argv: list[str] | None = None) -> int:
    """Judge the missing trials, print the table and draw the diagram."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seeds", choices=list(FIRST), default="development")
    parser.add_argument("--first", type=int, default=0, help="seeds from this one of them on")
    parser.add_argument(
        "--kinds", type=lambda text: text.split(","), default=[], help=f"of {', '.join(KINDS)}"
    )
    parser.add_argument("--jobs", type=int, default=2, choices=(1, 2), help="processes")
    parser.add_argument("--wrong", type=float, help="list the names that are wrong and at least so sure")
    parser.add_argument("--figure", type=Path, help="the diagram; else beside the rows")
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/gap-reliability"))
    args = parser.parse_args(argv)
    first = FIRST[args.seeds] + args.first
    plan = [(first + k, kind) for k, kind in enumerate(kinds(args.cases))]
    plan = [item for item in plan if not args.kinds or item[1] in args.kinds]
    path = args.out / f"{args.seeds}-{fingerprint()}.jsonl"
    words = f"seeds {first}..{first + args.cases - 1}"
    print(f"{len(plan)} logs, {args.seeds} {words}; rows in {path}", flush=True)
    made = rows(path, plan, lambda item: f"{item[1]}/{item[0]}", judged, args.jobs)
    print(told(made))
    if args.wrong is not None:
        print(wrong(made, args.wrong))
    names = given(made)
    title = f"{len(names)} names in {len(made)} logs, {words}; 90 % intervals"
    diagram(binned(names), title, args.figure or path.with_suffix(".svg"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
