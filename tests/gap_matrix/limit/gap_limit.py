"""The smallest size of each effect that `gap` names, compared with the detection limit of the same drives.

    python tests/gap_matrix/limit/gap_limit.py [--effects a,b] [--drives 18] [--seed 12000] [--jobs 2]

Named: the first finding has the correct name and scope and a confidence above 0.5. Detected: by an oracle
that knows name, scope and sign (`oracle.py`), at one false alarm in a hundred logs, shared by all names in
all scopes. Identified: by an oracle that also has to select the name (`choice.py`). Trials are run in three
stages, at the sizes that are most informative given the stages before, in units of the size that the oracle
detects in the same drive. Each trial is a line of JSON, so that an interrupted run continues.
"""

# ruff: noqa: E402 (the number of BLAS threads is set before numpy is imported)

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# gap_matrix is imported from the folder above it; with its own folder on the path, its modules shadow others.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

import numpy as np

from gap_matrix import cases
from gap_matrix.effects import KINDS, scale_effect
from gap_matrix.judge.diagnoses import compute_fingerprint
from gap_matrix.judge.resumed import Row, compute_rows, read_rows
from gap_matrix.limit import curve, figure, table
from gap_matrix.limit.oracle import compute_powers, interpolate_half_size
from gap_matrix.limit.trial import (
    draw_drive_setup,
    reduce_to_possible,
    round_to_hits,
    run_trial,
    typical_size,
)

FIRST_DEVELOPMENT_SEED, FIRST_TEST_SEED = 12_000, 412_000
N_STAGES = 3
DRIVE_DURATION_S = 60.0


def main(argv: list[str] | None = None) -> int:
    """Run the missing trials, print the table and draw the figure."""
    args = _parse_arguments(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    results = ResultStore(
        args.out / f"{args.seed}-{args.drives}-{_compute_sources_fingerprint()}.jsonl", args.jobs
    )
    seeds = range(args.seed, args.seed + args.drives)
    print(
        f"{len(args.effects)} effects, {args.drives} drives of {DRIVE_DURATION_S:.0f} s each, "
        f"seeds {seeds[0]}..{seeds[-1]} (development from {FIRST_DEVELOPMENT_SEED}, test from "
        f"{FIRST_TEST_SEED}); {len(results.rows)} rows in {results.path}"
    )
    start_time = time.monotonic()
    results.compute_missing({f"oracle/{seed}": partial(_compute_oracle_row, seed) for seed in seeds})
    results.compute_missing({f"nothing/{seed}": partial(_compute_clean_row, seed) for seed in seeds})
    for stage in range(N_STAGES):
        results.compute_missing(_plan_stage(results, stage, args.effects, list(seeds)))
        if args.progress:
            print(f"stage {stage + 1} of {N_STAGES}: {time.monotonic() - start_time:.0f} s", flush=True)
    limits = [table.compute_limit(name, *_collect_rows(results, name, seeds)) for name in args.effects]
    print(table.format_table(limits, results.rows, seeds))
    figure.draw_figure(limits, args.out / "limit.png")
    print(f"{args.out / 'limit.png'}; {sum(row['cpu'] for row in results.rows.values()):.0f} s of CPU")
    return 0


class ResultStore:
    """Rows of finished computations by key, in a file of JSON lines."""

    def __init__(self, path: Path, jobs: int) -> None:
        self.path, self._jobs = path, jobs
        self.rows: dict[str, Row] = {row["key"]: row for row in read_rows(path)}

    def compute_missing(self, planned: dict[str, partial[Row]]) -> None:
        """Compute the planned rows that are missing."""
        rows = compute_rows(self.path, list(planned.items()), _key, _compute_row, self._jobs)
        self.rows |= {row["key"]: row for row in rows}


def _key(item: tuple[str, partial[Row]]) -> str:
    return item[0]


def _compute_row(item: tuple[str, partial[Row]]) -> Row:
    key, compute = item
    return {"key": key, **compute()}


def _plan_stage(
    results: ResultStore, stage: int, names: list[str], seeds: list[int]
) -> dict[str, partial[Row]]:
    """Return the missing trials of a stage; each effect uses a third of the drives."""
    stage_seeds = np.array_split(seeds, N_STAGES)[stage]
    planned = {}
    for name in names:
        earlier = [row for row in _list_trials(results, name) if row["stage"] < stage]
        ln_sizes = curve.choose_next_sizes(
            [row["x"] for row in earlier], [row["named"] for row in earlier], len(stage_seeds)
        )
        for seed, ln_size in zip(stage_seeds.tolist(), ln_sizes, strict=True):
            power = results.rows[f"oracle/{seed}"]["powers"][name]
            planned[f"{name}/{seed}"] = partial(_compute_trial_row, name, seed, stage, power, ln_size)
    return planned


def _list_trials(results: ResultStore, name: str) -> list[Row]:
    """Return the rows of all trials of an effect."""
    return [row for key, row in results.rows.items() if key.startswith(f"{name}/")]


def _collect_rows(results: ResultStore, name: str, seeds: range) -> tuple[list[Row], list[Row], float]:
    """Return the trials of an effect, the powers of the oracle by drive, and the typical size."""
    trials = [row for row in _list_trials(results, name) if row["seed"] in seeds]
    powers = [results.rows[f"oracle/{seed}"]["powers"][name] for seed in seeds]
    return trials, powers, float(np.median([row["typical"] for row in trials]))


def _compute_oracle_row(seed: int) -> Row:
    """Return the powers of the oracle in one drive."""
    start_time = time.process_time()
    power_by_name = compute_powers(draw_drive_setup(seed, DRIVE_DURATION_S))
    powers = {
        name: {
            "factors": np.round(power.factors, 6).tolist(),
            "one": np.round(power.detected_alone, 6).tolist(),
            "priced": np.round(power.detected, 6).tolist(),
            "told": np.round(power.identified, 6).tolist(),
            "rival": power.alternative,
            "seen": power.mean_shift
            and {"centre": power.mean_shift.noncentrality, "freedom": power.mean_shift.dof},
            "least": power.min_factor,
        }
        for name, power in power_by_name.items()
    }
    return {"seed": seed, "powers": powers, "cpu": round(time.process_time() - start_time, 2)}


def _compute_clean_row(seed: int) -> Row:
    """Return the result of `gap` in one drive without a hidden effect."""
    return {"seed": seed, **run_trial(draw_drive_setup(seed, DRIVE_DURATION_S), None)}


def _compute_trial_row(name: str, seed: int, stage: int, power: Row, ln_size: float) -> Row:
    """Return the row of a trial.

    ln_size: ln of the size relative to the size that the oracle detects in half of the logs
    """
    start_time, setup = time.process_time(), draw_drive_setup(seed, DRIVE_DURATION_S)
    effect = cases.draw_hidden_effect(setup, name)
    half_size = interpolate_half_size(power["factors"], power["priced"])
    factor = round_to_hits(setup, effect, reduce_to_possible(effect, half_size * float(np.exp(ln_size))))
    row = {"seed": seed, "stage": stage, "x": float(np.log(factor / half_size)), "factor": factor}
    if power["seen"]:
        row["expected"] = 0.5 * (power["seen"]["centre"] * factor**2 + power["seen"]["freedom"])
    row |= {"typical": typical_size(effect), **run_trial(setup, scale_effect(effect, factor))}
    return {**row, "cpu": round(time.process_time() - start_time, 2)}


def _compute_sources_fingerprint() -> str:
    """Return a fingerprint of the sources that influence the rows."""
    folder = Path(__file__).parent
    digest = hashlib.sha256(compute_fingerprint().encode())
    for name in ("chance.py", "choice.py", "curve.py", "oracle.py", "trial.py"):
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()[:8]


def _parse_arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--effects", type=_parse_names, default=list(KINDS), help="default: all")
    parser.add_argument(
        "--drives", type=int, default=18, help="number of drives, a third of them in each stage"
    )
    parser.add_argument("--seed", type=int, default=FIRST_DEVELOPMENT_SEED, help="seed of the first drive")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--progress", action="store_true")
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/gap-limit"))
    return parser.parse_args(argv)


def _parse_names(text: str) -> list[str]:
    """Return a comma-separated list of effects; raises ArgumentTypeError for unknown names."""
    unknown = [name for name in text.split(",") if name not in KINDS]
    if unknown:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: not one of {', '.join(KINDS)}")
    return text.split(",")


if __name__ == "__main__":
    sys.exit(main())
