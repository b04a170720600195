"""Effects outside the vocabulary: hidden, scaffolded and searched again under their new name.

    python tests/gap_matrix/judge/scaffolded.py [--seeds 0:5] [--nats 2000] [--seconds 90]

named: `--scaffold` returned the correct formula on the correct node
within 3 σ: its parameters whose error is within 3 sigma
again: with the new effect loaded, the next search finds it first and leaves no gap

From logs without a hidden effect, or with one of the vocabulary, no effect may be scaffolded.
"""

# ruff: noqa: E402 (the number of BLAS threads is set before numpy is imported)

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# gap_matrix is imported from the folder above it; with its own folder on the path, its modules shadow others.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

import numpy as np

from gap_matrix import beyond, cases, recording
from gap_matrix.make_case import write_case
from hubodo.effects import BY_NAME
from hubodo.effects.loaded import use_effects
from hubodo.gap.explain.scaffold import Scaffold
from hubodo.gap.scaffold.scaffold import build_scaffold
from hubodo.gap.workflow import find_gap
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

LISTED_EFFECTS = (None, "lever_arm", "gyro_nonorthogonality", "node_misalignment", "clock_skew")
# Difference from the noise floor up to which a gap counts as closed.
_NO_GAP = 0.003


@dataclass
class Score:
    """Score of one kind of effect.

    n_runs: number of cases
    n_named: cases with the correct formula on the correct node
    n_found_again: cases in which the next search finds the effect first and leaves no gap
    normalised_errors: (estimate - truth) / sigma of every parameter with a sigma
    gaps: gap before and after the next search
    """

    n_runs: int = 0
    n_named: int = 0
    n_found_again: int = 0
    normalised_errors: list[float] = field(default_factory=list)
    gaps: list[tuple[float, float]] = field(default_factory=list)

    def format_row(self, name: str) -> str:
        """Return the score as a line of the table."""
        n_within = sum(abs(error) <= 3.0 for error in self.normalised_errors)
        rms = (sum(error**2 for error in self.normalised_errors) / max(len(self.normalised_errors), 1)) ** 0.5
        before, after = (
            sum(gaps) / max(len(self.gaps), 1) for gaps in zip(*self.gaps or [(0.0, 0.0)], strict=True)
        )
        return (
            f"{name:18}{self.n_named:4} of {self.n_runs}"
            f"{n_within:7} of {len(self.normalised_errors):2}{rms:9.2f}"
            f"{self.n_found_again:7} of {self.n_runs}   {before:.3f} → {after:.3f}"
        )


def write_hidden_case(
    folder: Path, name: str, seed: int, nats: float, duration: float, rate_hz: float | None = None
) -> beyond.UnlistedEffect:
    """Write a case with a hidden effect and return the effect.

    rate_hz: sample rate of both nodes, default drawn
    """
    setup = cases.draw_setup(seed, duration=duration)
    if rate_hz is not None:
        setup = cases.resample_nodes(setup, rate_hz, np.random.default_rng(seed))
    scaffold = beyond.hide_effect(setup, name, nats)
    recording.write_case_files(setup, [], folder, {}, scaffold.records)
    return scaffold


def scaffold_log(folder: Path, name: str) -> Scaffold | None:
    """Return the effect scaffolded from a log under that name, None if no new effect is needed."""
    result = find_gap(read_folder(folder), read_model(folder / "model.toml"))
    return build_scaffold(result.search, name, folder)


def search_again(folder: Path, scaffold: Scaffold) -> tuple[bool, float, float]:
    """Return whether the next search finds the effect and leaves no gap, and the gap before and after."""
    path = folder / f"{scaffold.name}.py"
    path.write_text(scaffold.source, "utf-8")
    use_effects([path])
    try:
        result = find_gap(read_folder(folder), read_model(folder / "model.toml"))
    finally:
        del BY_NAME[scaffold.name]
    is_first = bool(result.found) and (result.found[0].effect, result.found[0].scope) == (
        scaffold.name,
        scaffold.scope,
    )
    gap = result.gap
    return is_first and gap.after < (gap.floor or 1.0) + _NO_GAP, gap.before, gap.after


def run_case(
    score: Score, name: str, seed: int, nats: float, duration: float, rate_hz: float | None = None
) -> None:
    """Run one case of a kind and add it to the score."""
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "case"
        truth = write_hidden_case(case, name, seed, nats, duration, rate_hz)
        scaffold = scaffold_log(case, name)
        score.n_runs += 1
        if (
            scaffold is None
            or scaffold.scope != truth.node
            or not set(scaffold.parameters) <= set(truth.truth)
        ):
            print(
                f"  {name}, seed {seed}: "
                f"{'nothing' if scaffold is None else (scaffold.scope, sorted(scaffold.parameters))}"
            )
            return
        score.n_named += 1
        score.normalised_errors += [
            (it.value - truth.truth[key]) / it.sigma
            for key, it in scaffold.parameters.items()
            if it.sigma is not None
        ]
        n_found_again, before, after = search_again(case, scaffold)
        score.n_found_again += n_found_again
        score.gaps.append((before, after))


def scaffold_listed_effects(seed: int, duration: float) -> list[str]:
    """Return the effects scaffolded in error from logs without a hidden effect or with a listed one."""
    false_names = []
    for listed in LISTED_EFFECTS:
        with tempfile.TemporaryDirectory() as folder:
            case = Path(folder) / "case"
            write_case(case, seed, [] if listed is None else [listed], "strong", duration=duration)
            scaffold = scaffold_log(case, "nothing")
            if scaffold is not None:
                false_names.append(
                    f"{listed or 'nothing'}, seed {seed}: {sorted(scaffold.parameters)} ({scaffold.scope})"
                )
    return false_names


def main() -> int:
    """Print a line for each kind."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", default="0:5", help="first:last, without the last")
    parser.add_argument("--nats", type=float, default=2000.0)
    parser.add_argument("--seconds", type=float, default=90.0)
    parser.add_argument("--kinds", default=",".join(beyond.EFFECT_NAMES))
    args = parser.parse_args()
    seeds = range(*map(int, args.seeds.split(":")))
    print(f"{'kind':18}{'named':>8}{'within 3 σ':>14}{'rms z':>9}{'again':>10}   gap")
    total = Score()
    for name in args.kinds.split(","):
        score = Score()
        for seed in seeds:
            run_case(score, name, seed, args.nats, args.seconds)
        print(score.format_row(name), flush=True)
        total.n_runs, total.n_named, total.n_found_again = (
            total.n_runs + score.n_runs,
            total.n_named + score.n_named,
            total.n_found_again + score.n_found_again,
        )
        total.normalised_errors += score.normalised_errors
        total.gaps += score.gaps
    print(total.format_row("all"))
    false_names = [line for seed in seeds for line in scaffold_listed_effects(seed, args.seconds)]
    print(f"no new effect needed: {len(false_names)} of {len(seeds) * len(LISTED_EFFECTS)} logs gave a name")
    for line in false_names:
        print(f"  {line}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
