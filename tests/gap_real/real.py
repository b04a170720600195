"""Effects injected into real drives of a car: the model is learnt on one drive, and `gap` judges another one.

    python tests/gap_real/real.py [--pairs drive-1:drive-2] [--effects gyro_bias] [--strengths medium]
    python tests/gap_real/real.py --two-drives [--seed 1]

A model is learnt on each drive from the geometry and the noise of the vehicle alone. With it `gap` judges the
other drive as recorded, and with each effect in the samples of one node. The trivial baseline names nothing.
The clocks of two nodes differ in a drive as recorded, and their gyros lag: an injected offset, skew or lag
counts beyond the value that a fit to the drive as recorded gives.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parent)]

from car import CAR, MAX_ERROR_SHARE, MAX_ERROR_SIGMA, measure_recorded, read_drive  # noqa: E402
from sample_effects import Injection, injections  # noqa: E402
from two_drives import compare_pairs  # noqa: E402

from hubodo.gap.explain.missing_effects import MissingEffects  # noqa: E402
from hubodo.gap.explain.result import Finding  # noqa: E402
from hubodo.gap.explain.unnamed import is_unnamed  # noqa: E402
from hubodo.gap.workflow import find_gap  # noqa: E402
from hubodo.model.model_file import Model, read_model  # noqa: E402
from hubodo.model.model_text import write_model  # noqa: E402
from hubodo.recording import Recording  # noqa: E402

DRIVES = ("drive-1", "drive-2")
STRENGTHS = ("medium", "strong")
HIGH_CONFIDENCE = 0.9


@dataclass(frozen=True)
class Case:
    """One run: drive on which the model was learnt, judged drive, and effect in the samples of one node."""

    learnt_on: str
    drive: str
    effect: str = ""
    strength: str = ""
    node: str = ""


@dataclass(frozen=True)
class Row:
    """Result of one case.

    is_named, is_accurate: the effect was named on its node, and with its size
    wrong: names that are neither the effect nor of this drive
    unnamed: terms without a name, for structure that no known effect explains
    sure_right, sure: number of correct names with a confidence above 0.9, and of all such names, except
        those of the drive itself
    """

    case: Case
    is_named: bool
    is_accurate: bool
    wrong: tuple[str, ...]
    unnamed: tuple[str, ...]
    sure_right: int
    sure: int
    gap_before: float
    gap_after: float
    floor: float
    seconds: float


def list_cases(
    pairs: Sequence[tuple[str, str]], effects: Sequence[str], strengths: Sequence[str] = STRENGTHS
) -> Iterator[Case]:
    """Yield the unchanged drives, and each effect: medium on one side, strong on both."""
    names = list(dict.fromkeys(one.effect for one in injections(30.0, 1.0, 1.0)))
    for learnt_on, drive in pairs:
        yield Case(learnt_on, drive)
        for k, effect in enumerate(names):
            if effects and effect not in effects:
                continue
            sides = ("left", "right") if k % 2 else ("right", "left")
            if "medium" in strengths:
                yield Case(learnt_on, drive, effect, "medium", sides[0])
            if "strong" in strengths:
                for side in sides:
                    yield Case(learnt_on, drive, effect, "strong", side)


def learn(drive: str, folder: Path) -> MissingEffects:
    """Learn the model of the car on a drive, and write it."""
    path = folder / f"{drive}.toml"
    (folder / "car.toml").write_text(CAR, "utf-8")
    result = find_gap(read_drive(drive), read_model(folder / "car.toml"))
    write_model(result.model, path)
    return result


def find_injection(case: Case, recording: Recording, model: Model) -> Injection:
    """Return the effect of a case, in the size that belongs to the drive."""
    top_rate = max(float(np.abs(recording.nodes[name]["gz"]).max()) for name in ("left", "right"))
    return next(
        one
        for one in injections(top_rate, model.noise.gyro, model.noise.accel)
        if (one.effect, one.strength) == (case.effect, case.strength)
    )


def run_case(case: Case, folder: Path, seed: int) -> Row:
    """Judge a drive with the model of the other one."""
    recording, model = read_drive(case.drive), read_model(folder / f"{case.learnt_on}.toml")
    injection: Injection | None = None
    recorded: Mapping[str, float] = {}
    if case.effect:
        injection = find_injection(case, recording, model)
        recording = injection.apply(recording, case.node, seed)
        recorded = measure_recorded(read_drive(case.drive), model, case.effect, case.node)
    start = time.monotonic()
    result = find_gap(recording, model)
    right = [] if injection is None else [one for one in result.found if _is_right(one, injection, case.node)]
    others = [one for one in result.found if one not in right and not one.belongs_to_drive]
    sure = [one for one in (*right, *others) if one.confidence > HIGH_CONFIDENCE]
    return Row(
        case,
        bool(right),
        injection is not None and any(_is_accurate(one, injection, recorded) for one in right),
        tuple(f"{one.effect}/{one.scope}" for one in others if not is_unnamed(one)),
        tuple(f"{one.effect}/{one.scope}" for one in result.listed if is_unnamed(one)),
        sum(one in right for one in sure),
        len(sure),
        result.gap.before,
        result.gap.after,
        float(result.gap.floor or np.nan),
        time.monotonic() - start,
    )


def _is_right(finding: Finding, injection: Injection, node: str) -> bool:
    return finding.effect == injection.effect and finding.scope == node


def _is_accurate(finding: Finding, injection: Injection, recorded: Mapping[str, float]) -> bool:
    size = max(abs(value) for value in injection.parameters.values())
    for name, injected in injection.parameters.items():
        estimate = finding.parameters.get(name)
        if estimate is None:
            return False
        expected = (estimate.model_value or recorded.get(name, 0.0)) + injected
        error = abs(estimate.value - expected)
        tolerance = MAX_ERROR_SHARE * (abs(injected) if len(injection.parameters) == 1 else size)
        is_secondary = name == "time_constant" and len(injection.parameters) > 1
        if error > max(tolerance, MAX_ERROR_SIGMA * (estimate.sigma or 0.0)) and not is_secondary:
            return False
    return True


def print_summary(rows: Sequence[Row], own_gaps: Mapping[str, float]) -> None:
    """Print the figures of all cases.

    own_gaps: gap of each drive with the model learnt on it
    """
    effects = [row for row in rows if row.case.effect]
    plain = [row for row in rows if not row.case.effect]
    sure = sum(row.sure for row in rows)
    print(f"effects named on the right node:        {sum(row.is_named for row in effects)} of {len(effects)}")
    print(
        f"  and within 25 % or 3 sigma:           {sum(row.is_accurate for row in effects)} of {len(effects)}"
    )
    print(f"drives as they are, names not of it:    {sum(len(row.wrong) for row in plain)} in {len(plain)}")
    print(
        f"wrong names beside an effect:           {sum(len(row.wrong) for row in effects)} in {len(effects)}"
    )
    print(f"runs with a term without a name:        {sum(bool(row.unnamed) for row in rows)} of {len(rows)}")
    print(f"gap larger than before:                 {sum(row.gap_after > row.gap_before for row in rows)}")
    print(f"names above 0.9 that are right:         {sum(row.sure_right for row in rows)} of {sure}")
    print(f"seconds a run, median:                  {np.median([row.seconds for row in rows]):.0f}")
    for row in plain:
        if row.case.drive in own_gaps:
            ratio = row.gap_before / own_gaps[row.case.drive]
            print(
                f"gap of {row.case.drive} with the model of {row.case.learnt_on}, over its own: {ratio:.4f}"
            )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all cases, write their rows, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--pairs", default=",".join(f"{a}:{b}" for a in DRIVES for b in DRIVES if a != b))
    parser.add_argument("--effects", default="", help="only these")
    parser.add_argument("--strengths", default=",".join(STRENGTHS), help="'' for the drives as they are")
    parser.add_argument("--seed", type=int, default=1, help="of repeats, outliers")
    parser.add_argument("--output", type=Path, default=Path("out/gap-real"))
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--two-drives", action="store_true", help="compare the drives of each pair instead")
    options = parser.parse_args(arguments)
    pairs = [tuple(pair.split(":", 1)) for pair in options.pairs.split(",")]
    options.output.mkdir(parents=True, exist_ok=True)
    effects = [name for name in options.effects.split(",") if name]
    print(f"seed {options.seed}")
    if options.two_drives:
        return compare_pairs(options.pairs.split(","), effects, options.seed, options.output)
    own_gaps: dict[str, float] = {}
    for drive in sorted({first for first, _ in pairs}):
        result = learn(drive, options.output)
        own_gaps[drive] = result.gap.after
        names = ", ".join(f"{one.effect}/{one.scope}" for one in result.found)
        print(
            f"learnt on {drive}: gap {result.gap.before:.2f} -> {result.gap.after:.2f} "
            f"(noise {result.gap.floor:.2f}): {names}",
            flush=True,
        )
    cases = list(list_cases([(a, b) for a, b in pairs], effects, options.strengths.split(",")))
    run, rows = partial(run_case, folder=options.output, seed=options.seed), []
    with ProcessPoolExecutor(options.jobs) as pool, (options.output / "rows.jsonl").open("w") as file:
        for row in pool.map(run, cases):
            rows.append(row)
            file.write(json.dumps(asdict(row)) + "\n")
            file.flush()
            case = row.case
            label = f"{case.effect or 'as it is'} {case.strength} {case.node}".strip()
            verdict = "right" if row.is_accurate else "named" if row.is_named else "-"
            print(
                f"{case.learnt_on} on {case.drive}, {label:38} {verdict:6} "
                f"gap {row.gap_before:.3f} -> {row.gap_after:.3f}  {' '.join((*row.wrong, *row.unnamed))}",
                flush=True,
            )
    print_summary(rows, own_gaps)
    return 0


if __name__ == "__main__":
    sys.exit(main())
