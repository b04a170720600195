"""Kinds of effect outside the list: hidden, scaffolded and searched again under their new name.

    python tests/gap_matrix/judge/scaffolded.py [--seeds 0:5] [--nats 2000] [--seconds 90]

named: `--scaffold` made an effect of the right formula on the right node. within 3 σ: of its parameters.
    again: with it loaded, the next search finds it first, by that name, and leaves no gap. Logs in which
    nothing, or an effect of the list, is hidden may give no name.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The package is found from its parent; this folder itself must not stand on the path, or its names would.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

import numpy as np

from gap_matrix import beyond, cases, recording
from gap_matrix.make_case import write_case
from hubodo.effects import BY_NAME
from hubodo.effects.loaded import use_effects
from hubodo.gap.scaffold.scaffold import Scaffold, build_scaffold
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

LISTED = (None, "lever_arm", "gyro_nonorthogonality", "node_misalignment", "clock_skew")
# A gap so near to that of noise alone is none.
_NO_GAP = 0.003


@dataclass
class Score:
    """Score of one kind; pulls: (estimate - truth) / sigma of every parameter with a known truth."""

    runs: int = 0
    named: int = 0
    again: int = 0
    pulls: list[float] = field(default_factory=list)
    gaps: list[tuple[float, float]] = field(default_factory=list)

    def row(self, name: str) -> str:
        within = sum(abs(pull) <= 3.0 for pull in self.pulls)
        spread = (sum(pull**2 for pull in self.pulls) / max(len(self.pulls), 1)) ** 0.5
        before, after = (
            sum(gaps) / max(len(self.gaps), 1) for gaps in zip(*self.gaps or [(0.0, 0.0)], strict=True)
        )
        return (
            f"{name:18}{self.named:4} of {self.runs}{within:7} of {len(self.pulls):2}{spread:9.2f}"
            f"{self.again:7} of {self.runs}   {before:.3f} → {after:.3f}"
        )


def hidden(
    folder: Path, name: str, seed: int, nats: float, seconds: float, rate_hz: float | None = None
) -> beyond.Beyond:
    """Write the case; `rate_hz`: of both nodes, default drawn."""
    setup = cases.setup(seed, duration=seconds)
    if rate_hz is not None:
        setup = cases.sampled_at(setup, rate_hz, np.random.default_rng(seed))
    made = beyond.hide(setup, name, nats)
    recording.write(setup, [], folder, {}, made.records)
    return made


def scaffolded(folder: Path, name: str) -> Scaffold | None:
    """Return the scaffold of a log under that name."""
    found = find_gap(read_folder(folder), read_model(folder / "model.toml"))
    return build_scaffold(found.search, name, folder)


def found_again(folder: Path, made: Scaffold) -> tuple[bool, float, float]:
    """Return True if the next search finds that name first, and the gap before and after."""
    path = folder / f"{made.name}.py"
    path.write_text(made.source, "utf-8")
    use_effects([path])
    try:
        result = find_gap(read_folder(folder), read_model(folder / "model.toml"))
    finally:
        del BY_NAME[made.name]
    first = bool(result.found) and (result.found[0].effect, result.found[0].scope) == (made.name, made.scope)
    gap = result.gap
    return first and gap.after < (gap.floor or 1.0) + _NO_GAP, gap.before, gap.after


def tried(
    score: Score, name: str, seed: int, nats: float, seconds: float, rate_hz: float | None = None
) -> None:
    """Run one case of a kind."""
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "case"
        truth = hidden(case, name, seed, nats, seconds, rate_hz)
        made = scaffolded(case, name)
        score.runs += 1
        if made is None or made.scope != truth.node or not set(made.parameters) <= set(truth.truth):
            print(
                f"  {name}, seed {seed}: "
                f"{'nothing' if made is None else (made.scope, sorted(made.parameters))}"
            )
            return
        score.named += 1
        score.pulls += [
            (it.value - truth.truth[key]) / it.sigma
            for key, it in made.parameters.items()
            if it.sigma is not None
        ]
        again, before, after = found_again(case, made)
        score.again += again
        score.gaps.append((before, after))


def made_of_nothing(seed: int, seconds: float) -> list[str]:
    """Return the names scaffolded from logs without hidden effects."""
    wrong = []
    for listed in LISTED:
        with tempfile.TemporaryDirectory() as folder:
            case = Path(folder) / "case"
            write_case(case, seed, [] if listed is None else [listed], "strong", duration=seconds)
            made = scaffolded(case, "nothing")
            if made is not None:
                wrong.append(f"{listed or 'nothing'}, seed {seed}: {sorted(made.parameters)} ({made.scope})")
    return wrong


def main() -> int:
    """Print a row for each kind."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", default="0:5", help="first:last")
    parser.add_argument("--nats", type=float, default=2000.0)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--kinds", default=",".join(beyond.NAMES))
    args = parser.parse_args()
    seeds = range(*map(int, args.seeds.split(":")))
    print(f"{'kind':18}{'named':>8}{'within 3 σ':>14}{'rms pull':>9}{'again':>10}   gap")
    total = Score()
    for name in args.kinds.split(","):
        score = Score()
        for seed in seeds:
            tried(score, name, seed, args.nats, args.seconds)
        print(score.row(name), flush=True)
        total.runs, total.named, total.again = (
            total.runs + score.runs,
            total.named + score.named,
            total.again + score.again,
        )
        total.pulls += score.pulls
        total.gaps += score.gaps
    print(total.row("all"))
    wrong = [line for seed in seeds for line in made_of_nothing(seed, args.seconds)]
    print(f"nothing to name: {len(wrong)} of {len(seeds) * len(LISTED)} logs gave a name all the same")
    for line in wrong:
        print(f"  {line}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
