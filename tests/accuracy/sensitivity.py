"""Sensitivity of the wheel filter to its constants: each at half and at twice its value.

    python tests/accuracy/sensitivity.py [--seeds 1] [--only PART ...] [--results out/sensitivity.jsonl]

Constants are found by walking the modules of `hubodo.fuse.wheel`. For each the tool runs two sets of seeded
drives: five usual ones (loops with slip, one wheel and two, a clipped gyro, an outage), and the short ones
of `generators/fault_drives.py` (mounting, standstill beside an engine, clipping, outages, clocks, slip). It
prints by how much the mean error at the end and the mean NEES change, and on how many drives a pose, a slip
or a warning changes. Runs are stored in the results file, so an interrupted run continues where it stopped.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import hashlib
import importlib
import json
import os
import pkgutil
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

import hubodo.fuse.wheel
from accuracy import slip
from generators.clipped_drives import CASES as CLIPPED
from generators.clipped_drives import clipped_drive
from generators.fault_drives import FAULTS, FaultDrive
from generators.outages import drive_with_outage
from hubodo.fuse.wheel.config import WheelNoise
from hubodo.fuse.wheel.motion_state import StandstillLimits
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeeds, average_surface_speeds
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.recording import Table
from script_arguments import script_parser
from wheel_runs import BOTH, config, end_error, nees, tables

FACTORS = (0.5, 2.0)
DEFAULTS = (WheelNoise, StandstillLimits)
"""Classes whose default values count as constants too."""

LAYOUT = {
    *(
        "WINDOW_S",
        "WINDOWS_PER_SECOND",
        "ALIGNMENT_WINDOWS",
        "N_ROWS",
        "MISSING",
        "HISTORY_WINDOWS",
        "BOTH_WHEELS",
    ),
    *(
        "GYRO_SCALE_COVARIANCE",
        "UNIFORM_ANGLE_SIGMA",
        "_MAX_BLIND_VARIANCE",
        "_FULL_TURN",
        "SUM_LENGTHS_WINDOWS",
        "_FULL_SHARE",
    ),
}
"""Constants that define the data or follow from others."""

UNUSED = ("calibration.", "node_screening", "surface_speeds", "smoother", "fixed_lag")
"""Modules that these drives do not use."""

MAX_NEES = 100.0
"""Cap on the NEES of one drive in a mean, so that one diverged track does not hide all others."""

SLIPS = (
    "one wheel, lifted 6 s, stopped by something",
    "one wheel, lifted 6 s, runs out in 3 s",
    "two wheels, 1.5 s of double spin",
)


class Number(NamedTuple):
    """One number of a constant: module or class, name, index within a tuple (None: the constant itself)."""

    owner: str
    name: str
    index: int | None
    value: float

    def __str__(self) -> str:
        return f"{self.owner}.{self.name}" + ("" if self.index is None else f"[{self.index}]")


class Result(NamedTuple):
    """Error, % of the distance, NEES of 3, and a digest of poses, slips and warnings, of each drive."""

    errors: list[float]
    nees: list[float]
    digests: list[str]


def find_numbers() -> list[Number]:
    """Return the numbers of all module constants and of the default values."""
    numbers: list[Number] = []
    package = hubodo.fuse.wheel
    for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if info.name.removeprefix(f"{package.__name__}.").startswith(UNUSED):
            continue
        module = importlib.import_module(info.name)
        source = Path(str(module.__file__)).read_text("utf-8")
        for line in source.split("\n"):
            match = re.match(r"^(_?[A-Z][A-Z0-9_]*(?:, _?[A-Z][A-Z0-9_]*)*)(?:: [^=]+)? = (.*)", line)
            if match is None or not re.search(r"\d", match[2]) or "range(" in match[2]:
                continue
            for name in match[1].split(", "):
                if name not in LAYOUT:
                    numbers += _numbers_of(info.name, name, getattr(module, name))
    for owner in DEFAULTS:
        numbers += [Number(owner.__name__, it.name, None, float(it.default)) for it in fields(owner)]
    return numbers


def _numbers_of(module: str, name: str, value: Any) -> list[Number]:
    short = module.removeprefix("hubodo.fuse.wheel.")
    if isinstance(value, int | float):
        return [Number(short, name, None, float(value))]
    if isinstance(value, tuple) and all(isinstance(item, int | float) for item in value):
        return [Number(short, name, index, float(item)) for index, item in enumerate(value)]
    return []


@contextmanager
def scaled(number: Number, factor: float) -> Iterator[None]:
    """Multiply a number in all modules that use it; integers are rounded and stay at least 1."""
    owner = next((it for it in DEFAULTS if it.__name__ == number.owner), None)
    if owner is not None:
        defaults = owner.__init__.__defaults__
        place = [it.name for it in fields(owner)].index(number.name)
        changed = tuple(v * factor if k == place else v for k, v in enumerate(defaults or ()))
        owner.__init__.__defaults__ = changed
        try:
            yield
        finally:
            owner.__init__.__defaults__ = defaults
        return
    module = sys.modules[f"hubodo.fuse.wheel.{number.owner}"]
    before = getattr(module, number.name)

    def scale(value: float) -> float:
        return max(1, round(value * factor)) if isinstance(value, int) else value * factor

    if number.index is None:
        after: Any = scale(before)
    else:
        after = tuple(scale(item) if k == number.index else item for k, item in enumerate(before))
    changed: list[tuple[ModuleType, str, Any]] = []
    _replace_constant(number.name, before, after, changed)
    try:
        yield
    finally:
        for user, name, value in reversed(changed):
            setattr(user, name, value)


def _replace_constant(name: str, before: Any, after: Any, changed: list[tuple[ModuleType, str, Any]]) -> None:
    """Replace a constant in all modules, and the constants whose expressions contain it.

    changed: appended to; module, name and former value of each.
    """
    users = [user for key, user in list(sys.modules.items()) if key.startswith("hubodo.fuse.wheel")]
    users = [user for user in users if getattr(user, name, None) == before]
    for user in users:
        changed.append((user, name, before))
        setattr(user, name, after)
    for user in users:
        source = Path(str(user.__file__)).read_text("utf-8")
        pattern = rf"^(_?[A-Z][A-Z0-9_]*)(?:: [^=]+)? = (.*\b{name}\b.*)$"
        for derived, expression in re.findall(pattern, source, re.MULTILINE):
            value = eval(expression, vars(user))
            if value != getattr(user, derived):
                _replace_constant(derived, getattr(user, derived), value, changed)


def make_drives(seeds: range) -> dict[str, list[FaultDrive]]:
    """Return both sets of drives."""
    usual, faults = [], []
    for seed in seeds:
        for name in SLIPS:
            drive, nodes, _ = slip.make_drive(slip.CASES[name], seed)
            usual.append(FaultDrive(drive, nodes))
        case = CLIPPED["20 m/s"]
        usual.append(FaultDrive(clipped_drive(case, seed), BOTH, case.limits))
        usual.append(FaultDrive(drive_with_outage(seed, 20.0, "turns")[0]))
        faults += [make(seed) for make in FAULTS.values()]
    return {"usual": usual, "faults": faults}


def encoder_speeds(it: FaultDrive) -> SurfaceSpeeds:
    """Return the speeds of an encoder with a scale error of 1 % on each wheel that does not slip."""
    t = np.arange(0.0, it.drive.t[-1], 0.02)
    speed, heading = (np.interp(t, it.drive.t, column) for column in (it.drive.speed, it.drive.heading))
    half = 0.5 * it.drive.track * np.gradient(heading, t)
    return average_surface_speeds(
        Table({"t": t, "left": 1.01 * (speed - half), "right": 0.99 * (speed + half)})
    )


def measure(drives: list[FaultDrive]) -> Result:
    """Run the filter over all drives; a drive that it cannot finish has an infinite error."""
    result = Result([], [], [])
    for it in drives:
        settings = config(it.drive, it.nodes, limits=it.limits, encoder_aided=it.has_encoder)
        speeds = encoder_speeds(it) if it.has_encoder else None
        try:
            run = run_wheel_filter(settings, tables(it.drive), 0.0, speeds)
            numbers = 100.0 * end_error(it.drive, run) / it.drive.length, nees(it.drive, run)
            digest = hashlib.sha256(repr((run.report.warnings, run.report.slips)).encode())
            for column in (run.track.x, run.track.y, run.track.heading, run.track.covariance):
                digest.update(np.ascontiguousarray(column).tobytes())
            text = digest.hexdigest()[:16]
        except (ValueError, IndexError, ArithmeticError, np.linalg.LinAlgError) as error:
            numbers, text = (float("inf"), float("inf")), type(error).__name__
        result.errors.append(numbers[0])
        result.nees.append(numbers[1])
        result.digests.append(text)
    return result


def compare(result: Result, usual: Result) -> str:
    """Return the changes of mean error and mean NEES, and the number of drives that change."""
    changed = sum(one != other for one, other in zip(result.digests, usual.digests, strict=True))
    if not changed:
        return "none"
    error = float(np.mean(result.errors) - np.mean(usual.errors))
    mean_nees = np.mean(np.minimum(result.nees, MAX_NEES)) - np.mean(np.minimum(usual.nees, MAX_NEES))
    return f"{error:+.2f}, {mean_nees:+.2f} ({changed})"


def main() -> int:
    """Print the table."""
    parser = script_parser(__doc__, seeds=1)
    parser.add_argument("--only", nargs="*", default=[""], help="parts of names; all without it")
    parser.add_argument("--sets", nargs="+", default=["usual", "faults"], choices=["usual", "faults"])
    parser.add_argument("--results", type=Path, default=Path("out/sensitivity.jsonl"))
    args = parser.parse_args()
    args.results.parent.mkdir(parents=True, exist_ok=True)
    lines = args.results.read_text("utf-8").splitlines() if args.results.exists() else []
    done = {row["key"]: Result(*row["result"]) for row in map(json.loads, lines)}
    seeds = range(100, 100 + args.seeds)
    sets = {name: drives for name, drives in make_drives(seeds).items() if name in args.sets}

    def result_of(key: str, drives: list[FaultDrive]) -> Result:
        if key not in done:
            done[key] = measure(drives)
            with args.results.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"key": key, "result": list(done[key])}) + "\n")
        return done[key]

    usual = {name: result_of(f"{name} {args.seeds}", drives) for name, drives in sets.items()}
    for name, result in usual.items():
        mean_nees = np.mean(np.minimum(result.nees, MAX_NEES))
        print(
            f"{name}: {len(result.errors)} drives, seeds {seeds[0]} to {seeds[-1]}: "
            f"error {np.mean(result.errors):.2f} %, NEES {mean_nees:.2f}"
        )
    columns = " | ".join(f"{name}, {size}" for name in sets for size in ("half", "twice"))
    print(f"change of error in %, of NEES (drives that change)\n| constant | value | {columns} |")
    print("|---" * (2 + len(FACTORS) * len(sets)) + "|")
    for number in find_numbers():
        if not any(part in str(number) for part in args.only):
            continue
        cells = []
        for name, drives in sets.items():
            for factor in FACTORS:
                with scaled(number, factor):
                    result = result_of(f"{name} {args.seeds} {number} {factor}", drives)
                cells.append(compare(result, usual[name]))
        print(f"| `{number}` | {number.value:g} | {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
