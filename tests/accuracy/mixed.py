"""Drives of all kinds, drawn at random, and whether one wheel and two are as far off as they say.

    python tests/accuracy/mixed.py [--drives 200] [--first-seed 5000]

Each drive has a vehicle of its own (wheels of 5 to 35 cm), a top speed of 0.05 to 20 m/s, rests of 0 to 120 s
at the start and on the way, noise of half to ten times a data sheet's, flicker, tilts, arms, clocks and road
drawn anew; every third goes over hills on a rough road, every fourth loses its grip once. Made by
tests/generators, which share no code with the filter; the filter is told nominal values only. NEES of x, y
and heading at the end: 3 is true. The rival is plain differential odometry from the same two gyros.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np
from scipy.stats import chi2

import wheel_runs
from generators import slip_drives, wheel_drives
from hubodo.fuse.wheel.track import run

NAMES = {"left": ("left",), "two": ("left", "right")}
FASTEST_SPIN = 33.0
"""rad/s; what is faster is clipped, which clipped.py shows."""
DEGREES = 3


@dataclass(frozen=True)
class Drawn:
    """A drive and what is told of it."""

    drive: wheel_drives.WheelDrive
    top_speed: float
    noise: float
    rested: float
    slips: bool
    hilly: bool


def drawn(seed: int) -> Drawn:
    """The drive of a seed."""
    rng = np.random.default_rng(seed)
    top = float(np.exp(rng.uniform(np.log(0.05), np.log(20.0))))
    radius = max(float(rng.uniform(0.05, 0.35)), 1.15 * top / FASTEST_SPIN)
    track = float(rng.uniform(3.0, 6.0)) * min(radius, 0.3)
    parts = [(float(rng.choice([0.5, 5.0, 20.0, 120.0])), 0.0, 0.0)]
    rested, moving = parts[0][0], 0.0
    while moving < 90.0:
        duration = float(rng.uniform(4.0, 15.0))
        speed = top * float(rng.uniform(0.4, 1.0)) * float(rng.choice([1.0, 1.0, 1.0, -0.3]))
        # No more than 2 m/s² sideways, nor than 0.6 rad/s.
        turn = min(0.6, 2.0 / max(abs(speed), 0.1)) * float(rng.uniform(-1.0, 1.0))
        parts.append((duration, speed, turn))
        moving += duration
        if rng.uniform() < 0.15:
            rest = float(rng.choice([2.0, 10.0, 60.0]))
            parts.append((rest, 0.0, 0.0))
            rested += rest
    parts.append((4.0, 0.0, 0.0))
    plan = wheel_drives.ramps(parts)
    hilly = seed % 3 == 0 and top > 0.3
    if hilly:
        plan = slip_drives.hilly(plan, rng)
    slips = seed % 4 == 0 and top > 0.5
    if slips:
        fast = np.flatnonzero(np.abs(plan.speed) > 0.5 * top) / wheel_drives.RATE_HZ
        start = float(rng.choice(fast[len(fast) // 4 : -len(fast) // 4]))
        loss = float(rng.choice([-0.8, 0.8])) * top
        plan = wheel_drives.with_slip(
            plan, str(rng.choice(["left", "right"])), start, float(rng.uniform(1, 5)), loss
        )
    noise = float(np.exp(rng.uniform(np.log(0.5), np.log(10.0))))
    wide = float(rng.uniform(0.5, 2.0))
    errors = wheel_drives.Errors(
        noise=noise,
        tilt=np.radians(wide),
        arm=0.1 * radius * wide,
        clock=float(rng.choice([0.0, 0.003, 0.01])),
        flicker=float(rng.choice([0.0, 1e-4, 5e-4])),
        vibration=float(rng.choice([0.05, 0.3, 1.0])),
    )
    rate = float(rng.choice([104.0, 208.0]))
    made = wheel_drives.drive(plan, rng, errors, radius, track, rate_hz=rate)
    return Drawn(made, top, noise, rested, slips, hilly)


def plain(drive: wheel_drives.WheelDrive) -> float:
    """m at the end of differential odometry from the spin gyros, less what they show in the first half second."""
    t = np.arange(0.5, drive.t[-1] - 0.2, 0.01)
    speed = {}
    for name, node in drive.nodes.items():
        still = node.gyro[node.t < node.t[0] + 0.5, 2].mean()
        speed[name] = np.interp(t, node.t, node.gyro[:, 2] - still) * drive.radius
    heading = np.cumsum((speed["right"] - speed["left"]) / drive.track) * 0.01
    way = 0.5 * (speed["left"] + speed["right"]) * 0.01
    x, y = np.sum(way * np.cos(heading)), np.sum(way * np.sin(heading))
    return float(np.hypot(x - drive.x[-1], y - drive.y[-1]))


def main() -> int:
    """Prints the drives by kind; 1 where the mean NEES of all leaves its bounds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drives", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=5000)
    parser.add_argument("--each", action="store_true", help="a line for each drive")
    args = parser.parse_args()
    seeds = range(args.first_seed, args.first_seed + args.drives)
    kinds: list[list[str]] = []
    rows = []
    for seed in seeds:
        it = drawn(seed)
        numbers = [plain(it.drive) / it.drive.length]
        for names in NAMES.values():
            found = run(wheel_runs.config(it.drive, names), wheel_runs.tables(it.drive))
            numbers += [
                wheel_runs.end_error(it.drive, found) / it.drive.length,
                wheel_runs.nees(it.drive, found),
            ]
        rows.append(numbers)
        kinds.append(["all", *_kinds(it)])
        if args.each:
            cells = " ".join(f"{100 * numbers[k]:8.2f} % NEES {numbers[k + 1]:8.1f}" for k in (1, 3))
            print(f"{seed} {cells}  {', '.join(kinds[-1][1:])}", flush=True)
    table = np.array(rows)
    print(f"\n{args.drives} drives of all kinds, seeds {seeds[0]} to {seeds[-1]}")
    print(
        f"{'':28s}{'drives':>7s} {'plain':>9s}   {'one wheel: error, NEES, <95 %':>32s}   {'two wheels':>32s}"
    )
    for kind in dict.fromkeys(name for row in kinds for name in row):
        _print(kind, table[[kind in row for row in kinds]])
    means = table[:, [2, 4]].mean(axis=0)
    held = bool(((means >= 0.7 * DEGREES) & (means <= 2.0 * DEGREES)).all())
    print(
        f"required: mean NEES of all between {0.7 * DEGREES:.1f} and {2 * DEGREES:.1f}: {'met' if held else 'missed'}"
    )
    return int(not held)


def _kinds(it: Drawn) -> list[str]:
    fast = next(
        words
        for limit, words in ((0.3, "below 0.3 m/s"), (3.0, "0.3 to 3 m/s"), (99.0, "above 3 m/s"))
        if it.top_speed < limit
    )
    noisy = "noise above 3 times" if it.noise > 3.0 else "noise below 3 times"
    rested = "rests above 60 s" if it.rested > 60.0 else "rests below 60 s"
    return [fast, noisy, rested, "slips" if it.slips else "grips", "hilly" if it.hilly else "level"]


def _print(kind: str, table: np.ndarray) -> None:
    inside = chi2.ppf(0.95, DEGREES)
    cells = "   ".join(
        f"{100 * np.median(table[:, k]):8.2f} %{np.mean(table[:, k + 1]):9.1f}{np.median(table[:, k + 1]):7.1f}"
        f"{np.mean(table[:, k + 1] < inside):6.0%}"
        for k in (1, 3)
    )
    print(f"{kind:28s}{len(table):7d} {100 * np.median(table[:, 0]):7.1f} %   {cells}")


if __name__ == "__main__":
    sys.exit(main())
