"""Semi-real matrix: effects hidden in simulated drives whose noise is that of real drives of a car.

    python tests/gap_real/semi_real.py [--effects gyro_bias,...] [--strengths strong] [--nulls 40] [--size 1]

The independent simulator drives the wheels. The residuals of real drives, resampled in blocks, replace its
white noise. The speed comes from the wheels' own gyros, the yaw rate from a node on the body. Rows are stored
in a file per fingerprint of the sources, so that an interrupted run continues.
"""

# ruff: noqa: E402 (the number of BLAS threads is set before numpy is imported)

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parent)]

import numpy as np
from real import CAR, DRIVES, HIGH_CONFIDENCE, MAX_ERROR_SHARE, MAX_ERROR_SIGMA, read_drive
from residual_noise import extract_noise, load_noise
from semi_case import EFFECT_NAMES, Sizing, draw_case

from gap_matrix.effects import Effect
from gap_matrix.judge.diagnoses import compute_fingerprint
from gap_matrix.judge.resumed import Row, compute_rows, read_rows
from hubodo.gap.explain.missing_effects import MissingEffects
from hubodo.gap.explain.result import Finding
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.workflow import find_gap
from hubodo.model.model_file import read_model

FIRST_SEED, FIRST_NULL_SEED = 610_000, 620_000
_SOURCES = ("residual_noise.py", "semi_case.py", "semi_gain.py", "semi_real.py")
_N_HYPOTHESES = 5
# Effects of the drives as recorded that `gap` does not name by itself: the clocks of the two nodes differ
# by 7 ms. A block of similar acceleration would carry that into a simulated drive.
_RECORDED = ("time_offset",)


@dataclass(frozen=True)
class Cell:
    """One case of the matrix; without an effect if `name` is empty."""

    name: str
    strength: str
    seed: int
    drive: str

    @property
    def key(self) -> str:
        return f"{self.name or 'nothing'}/{self.strength}/{self.seed}/{self.drive}"


def list_cells(
    names: Sequence[str], strengths: Sequence[str], cases_per_effect: int, n_nulls: int, seed_offset: int
) -> Iterator[Cell]:
    """Yield the effects in the noise of each real drive in turn, and drives without an effect."""
    for strength in strengths:
        for k, name in enumerate(EFFECT_NAMES):
            for n in range(cases_per_effect if name in names else 0):
                seed = FIRST_SEED + seed_offset + 10 * k + n
                yield Cell(name, strength, seed, DRIVES[(k + n) % len(DRIVES)])
    for n in range(n_nulls):
        yield Cell("", "", FIRST_NULL_SEED + seed_offset + n, DRIVES[n % len(DRIVES)])


def learn_noise(folder: Path) -> None:
    """Learn the model of the car on each real drive, and store what it does not explain."""
    for name in DRIVES:
        path = folder / f"{name}.npz"
        if path.exists():
            continue
        recording = read_drive(name)
        result = _find_gap_of_text(CAR, recording, _RECORDED)
        print(f"residuals of {name}: gap {result.gap.before:.2f} -> {result.gap.after:.2f}", flush=True)
        extract_noise(name, recording, result).save(path)


def _find_gap_of_text(text: str, recording: Any, accept: Sequence[str] = ()) -> MissingEffects:
    with tempfile.TemporaryDirectory(prefix="gap_semi_") as folder:
        path = Path(folder) / "model.toml"
        path.write_text(text, "utf-8")
        return find_gap(recording, read_model(path), accept=accept)


def run_cell(cell: Cell, folder: Path, size: float, duration: float | None, sizing: Sizing) -> Row:
    """Return the row of a case; `unmade` if no drive shows the effect, `error` if the search failed."""
    row: Row = {"key": cell.key, "name": cell.name, "strength": cell.strength, "drive": cell.drive}
    start = time.process_time()
    try:
        case = draw_case(
            load_noise(folder / f"{cell.drive}.npz"),
            cell.name,
            cell.strength,
            cell.seed,
            size,
            duration,
            sizing,
        )
    except ValueError as error:
        return {**row, "unmade": str(error)}
    row |= {
        "seed": case.setup.seed,
        "seconds": case.setup.drive.duration,
        "gain_nats": case.gain_nats,
        "real_nats": case.real_nats,
    }
    if case.effect is not None:
        parameters = dict(case.effect.parameters)
        row |= {"scope": case.effect.scope, "parameters": parameters, "visible": case.visible}
    try:
        result = _find_gap_of_text(case.write_model(), case.record())
    except Exception:  # noqa: BLE001 (a failed search is counted and does not end the run)
        return {**row, "error": traceback.format_exc(limit=-4)}
    row |= score_result(result, case.expected_effect, case.visible)
    return {**row, "cpu": round(time.process_time() - start, 1)}


def score_result(result: MissingEffects, effect: Effect | None, visible: Sequence[str]) -> Row:
    """Return the scores of a result: correct name, correct node, accurate value, other names.

    visible: parameters that are judged
    """
    named = [one for one in result.found if effect is not None and one.effect == effect.name]
    right = [one for one in named if effect is not None and one.scope == effect.scope]
    others = [one for one in result.found if one not in right]
    sure = [one for one in result.found if one.confidence > HIGH_CONFIDENCE]
    rounds = [
        [
            [
                *one.key,
                round(one.gain, 1),
                round(one.evidence, 1),
                round(one.probability, 4),
                one.objection,
                _list_held_out_gain(one.held_out_gain),
                round(judged.tempering, 2),
                round(one.surprise, 1),
            ]
            for k, one in enumerate(judged.hypotheses)
            if k < _N_HYPOTHESES or (effect is not None and one.key == (effect.name, effect.scope))
        ]
        for judged in result.search.rounds
    ]
    return {
        "named": bool(named),
        "right_node": bool(right),
        "accurate": effect is not None and any(is_accurate(one, effect, visible) for one in right),
        "admitted": any(effect is not None and effect.name in one.inseparable_from for one in result.found),
        "others": [f"{one.effect}/{one.scope}" for one in others],
        "sure": len(sure),
        "sure_right": sum(one in right for one in sure),
        "found": [
            [one.effect, one.scope, round(one.confidence, 4),
             {key: [value.value, value.sigma] for key, value in one.parameters.items()},
             list(one.inseparable_from)]
            for one in result.found
        ],
        "gap": [result.gap.before, result.gap.after, result.gap.floor],
        "held_out_gap": [result.held_out_gap.before, result.held_out_gap.after],
        "tempering": result.search.final.tempering,
        "rounds": rounds,
    }  # fmt: skip


def _list_held_out_gain(gain: HeldOutGain | None) -> list[float]:
    return [] if gain is None else [round(value, 1) for value in (gain.total, gain.z, gain.level_sigma)]


def is_accurate(finding: Finding, effect: Effect, visible: Sequence[str]) -> bool:
    """Return True if each visible parameter is within a share of the effect's size, or within some sigmas."""
    sizes = {name: effect.parameters[name] for name in visible}
    tolerance = MAX_ERROR_SHARE * float(np.linalg.norm(list(sizes.values())))
    return all(
        (estimate := finding.parameters.get(name)) is not None
        and abs(estimate.value - value) <= max(tolerance, MAX_ERROR_SIGMA * (estimate.sigma or 0.0))
        for name, value in sizes.items()
    )


def format_row(row: Row) -> str:
    """Return a row as one line."""
    if "unmade" in row or "error" in row:
        return f"?? {row['key']} {row.get('unmade') or row['error'].splitlines()[-1]}"
    if row["name"]:
        steps = (
            ("right", row["accurate"]),
            ("value wrong", row["right_node"]),
            ("node wrong", row["named"]),
            ("inseparable", row["admitted"]),
        )
        verdict = next((word for word, is_so in steps if is_so), "missed")
    else:
        verdict = "false" if row["others"] else "right"
    names = " ".join(f"{one[0]}/{one[1]} {one[2]:.2f}" for one in row["found"])
    gaps = f"gap {row['gap'][0]:.2f} -> {row['gap'][1]:.2f}"
    return f"{verdict:11} {row['key']} {row.get('scope', '')} {gaps}: {names}"


def print_summary(rows: Sequence[Row]) -> None:
    """Print the figures of all rows."""
    judged = [row for row in rows if "named" in row]
    for strength in dict.fromkeys(row["strength"] for row in rows if row["name"]):
        group = [row for row in judged if row["strength"] == strength]
        names = list(dict.fromkeys(row["name"] for row in group))
        all_right = [name for name in names if all(row["accurate"] for row in group if row["name"] == name)]
        n_admitted = sum(row["admitted"] and not row["named"] for row in group)
        counts = [sum(row[key] for row in group) for key in ("named", "right_node", "accurate")]
        print(
            f"{strength}: named {counts[0]}, on the right node {counts[1]}, with the right value {counts[2]} "
            f"of {len(group)} cases, {n_admitted} more stated as inseparable; "
            f"{len(all_right)} of {len(names)} effects right in all; "
            f"further names in {sum(bool(row['others']) for row in group)}"
        )
        real = [row["real_nats"] for row in group if np.isfinite(row["real_nats"])]
        print(f"  gain of these effects in the real noise, median: {np.median(real):.0f} nats")
    nulls = [row for row in judged if not row["name"]]
    print(f"without an effect: names in {sum(bool(row['found']) for row in nulls)} of {len(nulls)}")
    sure_right, sure = (sum(row[key] for row in judged) for key in ("sure_right", "sure"))
    print(f"names above 0.9 that are right: {sure_right} of {sure}")
    errors = np.array([error for row in judged for error in list_errors_in_sigma(row)])
    within = [int(np.sum(np.abs(errors) < limit)) for limit in (1.0, 2.0, 3.0)]
    print(f"values within 1, 2, 3 sigma: {within[0]}, {within[1]}, {within[2]} of {len(errors)}")
    print(f"gap larger than before: {sum(row['gap'][1] > row['gap'][0] for row in judged)} of {len(judged)}")
    print(f"not made or failed: {len(rows) - len(judged)}")
    if judged:
        print(f"processor time a case, median: {np.median([row['cpu'] for row in judged]):.0f} s")


def list_errors_in_sigma(row: Row) -> list[float]:
    """Return the errors of the parameters of the injected effect, where it is named, in their 1 sigma."""
    right = [one for one in row["found"] if row["name"] == one[0] and row.get("scope") == one[1]]
    return [
        (value - row["parameters"][name]) / sigma
        for one in right
        for name, (value, sigma) in one[3].items()
        if sigma and name in row["parameters"]
    ]


def _compute_fingerprint(*options: float | str | None) -> str:
    digest = hashlib.sha256(f"{compute_fingerprint()} {options}".encode())
    for name in _SOURCES:
        digest.update((Path(__file__).parent / name).read_bytes())
    return digest.hexdigest()[:8]


def _split_names(text: str) -> list[str]:
    names = text.split(",")
    if unknown := [name for name in names if name not in EFFECT_NAMES]:
        raise argparse.ArgumentTypeError(f"{', '.join(unknown)}: not one of {', '.join(EFFECT_NAMES)}")
    return names


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the missing cases and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--effects", type=_split_names, default=list(EFFECT_NAMES), help="only these")
    parser.add_argument("--strengths", type=lambda text: text.split(","), default=["strong", "medium"])
    parser.add_argument("--cases", type=int, default=1, help="of each effect and strength")
    parser.add_argument("--nulls", type=int, default=40, help="cases without an effect")
    parser.add_argument("--size", type=float, default=1.0, help="factor on the parameters of all effects")
    parser.add_argument(
        "--sizing",
        type=Sizing,
        default=Sizing.TYPICAL_SIZE,
        choices=list(Sizing),
        metavar="{typical,real,white}",
        help="strengths as shares of the typical size of an effect (typical, default),\n"
        "or in nats in the real noise (real) or in white noise (white)",
    )
    parser.add_argument("--seconds", type=float, help="of each drive; default 60, 120 or 240 by seed")
    parser.add_argument("--seed", type=int, default=0, help="added to all seeds")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("-o", dest="output", type=Path, default=Path("out/gap-semi"))
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    learn_noise(options.output)
    path = (
        options.output
        / f"rows-{_compute_fingerprint(options.size, options.seconds, options.sizing.value)}.jsonl"
    )
    cells = list(list_cells(options.effects, options.strengths, options.cases, options.nulls, options.seed))
    print(
        f"{len(cells)} cases, seeds from {FIRST_SEED + options.seed}, without effect from "
        f"{FIRST_NULL_SEED + options.seed}; {len(read_rows(path))} rows in {path}",
        flush=True,
    )
    run = partial(
        run_cell,
        folder=options.output,
        size=options.size,
        duration=options.seconds,
        sizing=options.sizing,
    )
    rows = compute_rows(
        path, cells, lambda cell: cell.key, run, options.jobs,
        lambda done, total, row: print(f"{done}/{total} {format_row(row)}", flush=True),
    )  # fmt: skip
    print_summary(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
