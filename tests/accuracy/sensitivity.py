"""Sensitivity of the wheel filter to its constants: each at half and at twice its value.

    python tests/accuracy/sensitivity.py [--seeds 1] [--only PART] [--results out/sensitivity.jsonl]

Constants are found by walking the modules of `hubodo.fuse.wheel`. For each the tool runs a small set of
seeded drives (loops with slip, one wheel and two, a clipped gyro, an outage) and prints by how much the mean
error at the end and the mean NEES change. "none" means that no pose changes at all on these drives. Runs are
stored in the results file, so an interrupted run continues where it stopped.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
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
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

import hubodo.fuse.wheel
from accuracy import slip
from generators.clipped_drives import CASES as CLIPPED
from generators.clipped_drives import clipped_drive
from generators.outages import drive_with_outage
from generators.wheel_drives import WheelDrive
from hubodo.fuse.wheel.config import WheelNoise
from hubodo.fuse.wheel.motion_state import StandstillLimits
from hubodo.fuse.wheel.track import run_wheel_filter
from wheel_runs import BOTH, config, end_error, nees, tables

FACTORS = (0.5, 2.0)
DEFAULTS = (WheelNoise, StandstillLimits)
"""Classes whose default values count as constants too."""

LAYOUT = {
    *("WINDOW_S", "ALIGNMENT_WINDOWS", "N_ROWS", "MISSING", "HISTORY_WINDOWS", "BOTH_WHEELS"),
    *("UNIFORM_ANGLE_SIGMA", "_FULL_TURN", "_GATE_NIS", "SUM_LENGTHS_WINDOWS", "_FULL_SHARE"),
}
"""Constants that define the data or follow from others."""

UNUSED = (
    "calibration.",
    "drive_warnings",
    "node_times",
    "node_screening",
    "surface_speeds",
    "smoother",
    "fixed_lag",
)
"""Modules that these drives do not use."""

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


class Drive(NamedTuple):
    """A seeded drive, its nodes, and saturation limits."""

    drive: WheelDrive
    nodes: tuple[str, ...]
    limits: dict[str, float] | None


class Result(NamedTuple):
    """Mean error, % of the distance, mean NEES of 3, and a digest of all poses."""

    error: float
    nees: float
    poses: float


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
    users = [
        it
        for key, it in list(sys.modules.items())
        if key.startswith("hubodo.fuse.wheel") and getattr(it, number.name, None) is before
    ]
    for user in users:
        setattr(user, number.name, after)
    try:
        yield
    finally:
        for user in users:
            setattr(user, number.name, before)


def make_drives(seeds: int) -> list[Drive]:
    """Return the set of drives."""
    drives = []
    for seed in range(100, 100 + seeds):
        for name in SLIPS:
            drive, nodes, _ = slip.made(slip.CASES[name], seed)
            drives.append(Drive(drive, nodes, None))
        case = CLIPPED["20 m/s"]
        drives.append(Drive(clipped_drive(case, seed), BOTH, case.limits))
        drives.append(Drive(drive_with_outage(seed, 20.0, "turns")[0], BOTH, None))
    return drives


def measure(drives: list[Drive]) -> Result:
    """Run the filter over all drives."""
    errors, honesty, poses = [], [], 0.0
    for drive, nodes, limits in drives:
        run = run_wheel_filter(config(drive, nodes, limits=limits), tables(drive))
        errors.append(100.0 * end_error(drive, run) / drive.length)
        honesty.append(nees(drive, run))
        poses += float(np.sum(run.track.x) + np.sum(run.track.y) + np.sum(run.track.covariance))
    return Result(float(np.mean(errors)), float(np.mean(honesty)), poses)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--results", type=Path, default=Path("out/sensitivity.jsonl"))
    args = parser.parse_args()
    args.results.parent.mkdir(parents=True, exist_ok=True)
    lines = args.results.read_text("utf-8").splitlines() if args.results.exists() else []
    done = {row["key"]: Result(*row["result"]) for row in map(json.loads, lines)}
    drives = make_drives(args.seeds)

    def result_of(key: str, number: Number | None = None, factor: float = 1.0) -> Result:
        key = f"{args.seeds} {key}"
        if key not in done:
            try:
                if number is None:
                    done[key] = measure(drives)
                else:
                    with scaled(number, factor):
                        done[key] = measure(drives)
            except (ValueError, IndexError, ArithmeticError, np.linalg.LinAlgError):
                done[key] = Result(float("inf"), float("inf"), float("inf"))
            with args.results.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"key": key, "result": list(done[key])}) + "\n")
        return done[key]

    usual = result_of("usual")
    seeds = f"seeds 100 to {99 + args.seeds}"
    print(f"{len(drives)} drives, {seeds}: error {usual.error:.2f} %, NEES {usual.nees:.2f}")
    print("| constant | value | half: error %, NEES | twice: error %, NEES |\n|---|---|---|---|")
    for number in find_numbers():
        if args.only in str(number):
            cells = []
            for factor in FACTORS:
                found = result_of(f"{number} {factor}", number, factor)
                change = f"{found.error - usual.error:+.2f}, {found.nees - usual.nees:+.2f}"
                cells.append("none" if found.poses == usual.poses else change)
            print(f"| `{number}` | {number.value:g} | {cells[0]} | {cells[1]} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
