"""The smallest size of each effect that `gap` names, beside the limit of what the same drives can show.

    python tests/gap_matrix/limit/gap_limit.py [--effects a,b] [--drives 18] [--seed 12000] [--jobs 2]

Named: the first finding has the right name and scope and a confidence above 0.5. The limit is that of an
    oracle which knows name, scope and sign (`oracle.py`), at one false alarm in a hundred logs, which all
    names in all scopes share; and that of one which has to choose among the names, too (`choice.py`). Trials
    come in three stages, each where the curve of those before it says most, in units of what the oracle sees
    in that very drive. Each is a line of JSON: what was interrupted goes on.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The package is found from its parent; this folder itself must not stand on the path, or its names would.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

import numpy as np

from gap_matrix import cases
from gap_matrix.effects import KINDS, scaled
from gap_matrix.judge.diagnoses import fingerprint
from gap_matrix.judge.resumed import Row, kept, rows
from gap_matrix.limit import curve, figure, table
from gap_matrix.limit.oracle import half_seen, oracle
from gap_matrix.limit.trial import drive, in_whole_hits, largest_possible, tried, typical

DEVELOPMENT, TEST = 12_000, 412_000
STAGES = 3
SECONDS = 60.0


def main(argv: list[str] | None = None) -> int:
    """Run the missing trials, print the table and draw the figure."""
    args = _arguments(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    done = Done(args.out / f"{args.seed}-{args.drives}-{_sources()}.jsonl", args.jobs)
    seeds = range(args.seed, args.seed + args.drives)
    print(
        f"{len(args.effects)} effects, {args.drives} drives of {SECONDS:.0f} s each, seeds {seeds[0]}.."
        f"{seeds[-1]} (development from {DEVELOPMENT}, test from {TEST}); {len(done.of)} rows in {done.path}"
    )
    begin = time.monotonic()
    done.fill({f"oracle/{seed}": partial(_oracle, seed) for seed in seeds})
    done.fill({f"nothing/{seed}": partial(_nothing, seed) for seed in seeds})
    for stage in range(STAGES):
        done.fill(_stage(done, stage, args.effects, list(seeds)))
        if args.progress:
            print(f"stage {stage + 1} of {STAGES}: {time.monotonic() - begin:.0f} s", flush=True)
    limits = [table.limit(name, *_of(done, name, seeds)) for name in args.effects]
    print(table.text(limits, done.of, seeds))
    figure.draw(limits, args.out / "limit.png")
    print(f"{args.out / 'limit.png'}; {sum(row['cpu'] for row in done.of.values()):.0f} s of CPU")
    return 0


class Done:
    """Finished results by key, in a growing file of JSON lines."""

    def __init__(self, path: Path, jobs: int) -> None:
        self.path, self._jobs = path, jobs
        self.of: dict[str, Row] = {row["key"]: row for row in kept(path)}

    def fill(self, wanted: dict[str, partial[Row]]) -> None:
        """Does what is wanted and not there yet."""
        made = rows(self.path, list(wanted.items()), _key, _made, self._jobs)
        self.of |= {row["key"]: row for row in made}


def _key(item: tuple[str, partial[Row]]) -> str:
    return item[0]


def _made(item: tuple[str, partial[Row]]) -> Row:
    key, make = item
    return {"key": key, **make()}


def _stage(done: Done, stage: int, names: list[str], seeds: list[int]) -> dict[str, partial[Row]]:
    """Return the trials of a stage, each effect in a part of the drives."""
    own = np.array_split(seeds, STAGES)[stage]
    wanted = {}
    for name in names:
        before = [row for row in _trials(done, name) if row["stage"] < stage]
        asked = curve.next_look([row["x"] for row in before], [row["named"] for row in before], len(own))
        for seed, x in zip(own.tolist(), asked, strict=True):
            power = done.of[f"oracle/{seed}"]["powers"][name]
            wanted[f"{name}/{seed}"] = partial(_trial, name, seed, stage, power, x)
    return wanted


def _trials(done: Done, name: str) -> list[Row]:
    return [row for key, row in done.of.items() if key.startswith(f"{name}/")]


def _of(done: Done, name: str, seeds: range) -> tuple[list[Row], list[Row], float]:
    trials = [row for row in _trials(done, name) if row["seed"] in seeds]
    powers = [done.of[f"oracle/{seed}"]["powers"][name] for seed in seeds]
    return trials, powers, float(np.median([row["typical"] for row in trials]))


def _oracle(seed: int) -> Row:
    begin = time.process_time()
    made = oracle(drive(seed, SECONDS))
    powers = {
        name: {key: np.round(getattr(power, key), 6).tolist() for key in ("factors", "one", "priced", "told")}
        | {"rival": power.rival, "seen": power.seen and asdict(power.seen), "least": power.least}
        for name, power in made.items()
    }
    return {"seed": seed, "powers": powers, "cpu": round(time.process_time() - begin, 2)}


def _nothing(seed: int) -> Row:
    return {"seed": seed, **tried(drive(seed, SECONDS), None)}


def _trial(name: str, seed: int, stage: int, power: Row, x: float) -> Row:
    begin, setup = time.process_time(), drive(seed, SECONDS)
    effect = cases.hidden_effect(setup, name)
    half = half_seen(power["factors"], power["priced"])
    factor = in_whole_hits(setup, effect, largest_possible(effect, half * float(np.exp(x))))
    made = {"seed": seed, "stage": stage, "x": float(np.log(factor / half)), "factor": factor}
    if power["seen"]:
        made["expected"] = 0.5 * (power["seen"]["centre"] * factor**2 + power["seen"]["freedom"])
    made |= {"typical": typical(effect), **tried(setup, scaled(effect, factor))}
    return {**made, "cpu": round(time.process_time() - begin, 2)}


def _sources() -> str:
    here = Path(__file__).parent
    made = hashlib.sha256(fingerprint().encode())
    for name in ("chance.py", "choice.py", "curve.py", "oracle.py", "trial.py"):
        made.update((here / name).read_bytes())
    return made.hexdigest()[:8]


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--effects", type=_names, default=list(KINDS), help="default: all")
    parser.add_argument("--drives", type=int, default=18, help="a third of them in each stage")
    parser.add_argument("--seed", type=int, default=DEVELOPMENT, help="of the first drive")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--progress", action="store_true")
    parser.add_argument("-o", dest="out", type=Path, default=Path("out/gap-limit"))
    return parser.parse_args(argv)


def _names(given: str) -> list[str]:
    unknown = [name for name in given.split(",") if name not in KINDS]
    if unknown:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: not one of {', '.join(KINDS)}")
    return given.split(",")


if __name__ == "__main__":
    sys.exit(main())
