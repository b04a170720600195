"""Comparison of two drives of a real car: unchanged, with an effect in the second, and from hub to rim.

    python tests/gap_real/real.py --two-drives [--pairs drive-1:drive-2] [--effects gyro_bias,...] [--seed 1]

Unchanged are also the twelve ordered pairs of halves of the two drives, unless `--effects` selects effects.
The model has only the geometry and the noise of the vehicle. A property of a drive, such as a bias, counts as
named if it is listed among the differences of the drives.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import permutations
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parent)]

import numpy as np  # noqa: E402
from car import (  # noqa: E402
    CAR,
    DELAY_EFFECTS,
    MAX_ERROR_SHARE,
    MAX_ERROR_SIGMA,
    measure_recorded,
    read_drive,
)
from sample_effects import Injection, injections  # noqa: E402

from hubodo.effects import BY_NAME  # noqa: E402
from hubodo.gap.change.change import compare_with_first_log, fit_first_log  # noqa: E402
from hubodo.gap.change.result import Change, ChangeResult  # noqa: E402
from hubodo.gap.problem.build import build_problem  # noqa: E402
from hubodo.gap.refit.linear_fit import Refit  # noqa: E402
from hubodo.model.model_file import Model, read_model  # noqa: E402

HALVES = tuple(f"{drive}/{half}" for drive in ("drive-1", "drive-2") for half in ("first", "second"))
# Pairs of different halves of drives of the same car, in either order.
UNCHANGED_PAIRS = tuple(permutations(HALVES, 2))
# Drive that was also recorded by sensors on the rims.
HUB_DRIVE = "drive-1"
# Length of the lever arm of the sensors on the rims, m.
RIM_ARM = (0.13, 0.18)


@dataclass(frozen=True)
class Row:
    """Result of one comparison.

    names: names of changes of the vehicle, in order
    of_drive: names of differences of the drives
    is_first, is_accurate: the injected effect is named first, and with its size
    """

    before: str
    after: str
    effect: str
    strength: str
    node: str
    names: tuple[str, ...]
    of_drive: tuple[str, ...]
    is_first: bool
    is_accurate: bool
    processor_seconds: float


@dataclass(frozen=True)
class FirstDrive:
    """The first drive of a pair, with the fit of what it lacks and the processor time of that fit in s."""

    name: str
    fit: Refit
    processor_seconds: float


def fit_drive(name: str, model: Model) -> FirstDrive:
    """Search the first drive of a pair."""
    start = time.process_time()
    fit = fit_first_log(build_problem(read_drive(name), model, name), name)
    return FirstDrive(name, fit, time.process_time() - start)


def list_cases(effects: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Yield the unchanged case, and effect, strength and node: medium and strong on alternate sides."""
    yield "", "", ""
    for k, one in enumerate(injections(30.0, 1.0, 1.0)):
        if not effects or one.effect in effects:
            yield one.effect, one.strength, ("left", "right")[k % 2]


def compare(first: FirstDrive, after: str, case: tuple[str, str, str], seed: int) -> tuple[Row, ChangeResult]:
    """Compare two drives, with an effect in the samples of the second unless the case is unchanged."""
    (effect, strength, node), model = case, first.fit.state.problem.model
    recording, injection = read_drive(after), None
    recorded: Mapping[str, float] = {}
    if effect:
        top_rate = max(float(np.abs(recording.nodes[name]["gz"]).max()) for name in ("left", "right"))
        choices = injections(top_rate, model.noise.gyro, model.noise.accel)
        injection = next(one for one in choices if (one.effect, one.strength) == (effect, strength))
        recording = injection.apply(recording, node, seed)
    start = time.process_time()
    result = compare_with_first_log(first.fit, recording, after)
    seconds = first.processor_seconds + time.process_time() - start
    is_of_drive = bool(effect) and BY_NAME[effect].varies_between_drives
    own = [change for change in result.changes if change.belongs_to_drive]
    pool = own if is_of_drive else list(result.vehicle_changes)
    named = [change for change in pool if (change.effect, change.scope) == (effect, node)]
    is_first = bool(named) and (is_of_drive or named[0] is pool[0])
    if named and effect in DELAY_EFFECTS:
        recorded = measure_recorded(read_drive(after), result.model_before, effect, node)
    is_accurate = bool(injection and named) and _is_accurate(named[0], injection, recorded)
    labels = [
        tuple(f"{change.effect}/{change.scope}" for change in changes)
        for changes in (result.vehicle_changes, own)
    ]
    return Row(
        first.name, after, effect, strength, node, labels[0], labels[1], is_first, is_accurate, seconds
    ), result


def _is_accurate(change: Change, injection: Injection, recorded: Mapping[str, float]) -> bool:
    """Return True if each injected parameter changed by its size within 25 % or 3 sigma.

    recorded: delay of the second drive as recorded, by a fit; the value in it counts beyond that
    """
    size = max(abs(value) for value in injection.parameters.values())
    for name, injected in injection.parameters.items():
        _, after, estimate = change.values[name]
        if name == "time_constant" and len(injection.parameters) > 1:
            continue
        is_absolute = name in recorded or not np.isfinite(estimate.value)
        value = after.value - recorded.get(name, 0.0) if is_absolute else estimate.value
        tolerance = MAX_ERROR_SHARE * (abs(injected) if len(injection.parameters) == 1 else size)
        if abs(value - injected) > max(tolerance, MAX_ERROR_SIGMA * (estimate.sigma or 0.0)):
            return False
    return True


def print_row(row: Row) -> None:
    """Print one comparison."""
    label = f"{row.effect or 'as it is'} {row.strength} {row.node}".strip()
    verdict = "right" if row.is_accurate and row.is_first else "named" if row.is_first else "-"
    print(
        f"{row.before} to {row.after}, {label:38} {verdict:6} {row.processor_seconds:3.0f} s  "
        f"{' '.join(row.names) or 'no change'}; of the drive: {' '.join(row.of_drive) or 'nothing'}",
        flush=True,
    )


def print_summary(rows: Sequence[Row]) -> None:
    """Print the figures of all comparisons."""
    unchanged, changed = ([row for row in rows if bool(row.effect) is flag] for flag in (False, True))
    n_false = sum(bool(row.names) for row in unchanged)
    print(f"unchanged pairs with a change named:  {n_false} of {len(unchanged)}")
    print(f"effects named first on their node:    {sum(row.is_first for row in changed)} of {len(changed)}")
    print(
        f"  and within 25 % or 3 sigma:         {sum(row.is_accurate for row in changed)} of {len(changed)}"
    )
    print(f"processor seconds, largest:           {max(row.processor_seconds for row in rows):.0f}")


def compare_hub_to_rim(hub: FirstDrive) -> bool:
    """Print the changes from the hubs to the rims; return True if both lever arms have the known length."""
    row, result = compare(hub, f"{hub.name}-rim", ("", "", ""), 0)
    print_row(row)
    lengths = {
        change.scope: float(np.hypot(change.values["x"][1].value, change.values["y"][1].value))
        for change in result.vehicle_changes
        if change.effect == "lever_arm"
    }
    print("lever arms on the rims: " + ", ".join(f"{name} {value:.3f} m" for name, value in lengths.items()))
    return bool(lengths) and all(RIM_ARM[0] <= value <= RIM_ARM[1] for value in lengths.values())


def compare_pairs(pairs: Sequence[str], effects: Sequence[str], seed: int, output: Path) -> int:
    """Run all comparisons and write each to a file; return 1 if the change from hub to rim is wrong.

    The fit of a first drive is shared by its pairs, and counts in the time of each.
    """
    (output / "car.toml").write_text(CAR, "utf-8")
    model = read_model(output / "car.toml")
    cases = [(*pair.split(":", 1), case) for pair in pairs for case in list_cases(effects)]
    cases += [] if effects else [(before, after, ("", "", "")) for before, after in UNCHANGED_PAIRS]
    rows, is_rim_right = list[Row](), True
    with (output / "pairs.jsonl").open("w") as file:
        for before in dict.fromkeys(case[0] for case in cases):
            first = fit_drive(before, model)
            if before == HUB_DRIVE:
                is_rim_right = compare_hub_to_rim(first)
            for _, after, case in (one for one in cases if one[0] == before):
                rows.append(compare(first, after, case, seed)[0])
                file.write(json.dumps(asdict(rows[-1])) + "\n")
                file.flush()
                print_row(rows[-1])
    if rows:
        print_summary(rows)
    return 0 if is_rim_right else 1
