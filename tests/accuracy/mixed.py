"""Random drives of all kinds: error and consistency of the sigmas with one wheel and with two.

    python tests/accuracy/mixed.py [--drives 200] [--first-seed 5000] [--stated-errors]

The drives come from tests/generators/mixed_drives.py, which shares no code with the filter; the filter only
has nominal values. NEES of x, y and heading at the end: 3 if consistent. The baseline is plain differential
odometry from the same two gyros. The median error is compared with the one that the covariances imply: where
they agree and the NEES is consistent, the error is that of the unknown quantities, not of the filter. The
drives' errors of radius and gyro scales are smaller than the filter's priors, which describe an uncalibrated
vehicle; with --stated-errors they are as large.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np
from scipy.stats import chi2

import wheel_runs
from generators import wheel_drives
from generators.mixed_drives import Drawn, drawn
from hubodo.fuse.wheel.track import WheelRun, run_wheel_filter
from script_arguments import script_parser

NAMES = {"left": ("left",), "two": ("left", "right")}
DEGREES = 3


def differential_odometry_error(drive: wheel_drives.WheelDrive, starts_at_standstill: bool = True) -> float:
    """Return the final error, m, of differential odometry from the spin gyros minus their initial mean.

    starts_at_standstill: True if the vehicle starts at standstill; otherwise the gyros are used uncorrected.
    """
    t = np.arange(0.5, drive.t[-1] - 0.2, 0.01)
    speed = {}
    for name, node in drive.nodes.items():
        bias = node.gyro[node.t < node.t[0] + 0.5, 2].mean() if starts_at_standstill else 0.0
        speed[name] = np.interp(t, node.t, node.gyro[:, 2] - bias) * drive.radius
    heading = np.cumsum((speed["right"] - speed["left"]) / drive.track) * 0.01
    distance = 0.5 * (speed["left"] + speed["right"]) * 0.01
    x, y = np.sum(distance * np.cos(heading)), np.sum(distance * np.sin(heading))
    return float(np.hypot(x - drive.x[-1], y - drive.y[-1]))


def implied_errors(result: WheelRun, seed: int) -> np.ndarray:
    """Return 100 final position errors, m, drawn from the covariance of the last pose."""
    covariance = result.track.covariance[-1, :2, :2]
    draws = np.random.default_rng(seed).multivariate_normal(np.zeros(2), covariance, size=100)
    return np.hypot(draws[:, 0], draws[:, 1])


def variance_ratios(drive: wheel_drives.WheelDrive, result: WheelRun) -> np.ndarray:
    """Return squared error / variance at the end, (3,): away from the start, across it, and in heading."""
    track = result.track
    error, covariance = wheel_runs.pose_error(drive, track, -1)
    angle = np.arctan2(track.y[-1], track.x[-1])
    rotation = np.eye(3)
    rotation[:2, :2] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    variances = np.diag(rotation @ covariance @ rotation.T)
    ratios: np.ndarray = (rotation @ error) ** 2 / variances
    return ratios


def main() -> int:
    """Print the drives by kind; return 1 where the mean NEES leaves its bounds."""
    parser = script_parser(__doc__, drives=200, first_seed=5000)
    parser.add_argument("--each", action="store_true", help="a line for each drive")
    parser.add_argument(
        "--stated-errors", action="store_true", help="radius and gyro scales as wrong as the filter assumes"
    )
    args = parser.parse_args()
    seeds = range(args.first_seed, args.first_seed + args.drives)
    kinds: list[list[str]] = []
    rows = []
    alarms = dict.fromkeys(NAMES, 0)
    implied: dict[str, list[np.ndarray]] = {name: [] for name in NAMES}
    ratios: dict[str, list[np.ndarray]] = {name: [] for name in NAMES}
    for seed in seeds:
        random_drive = drawn(seed, args.stated_errors)
        numbers = [differential_odometry_error(random_drive.drive) / random_drive.drive.length]
        for name, nodes in NAMES.items():
            result = run_wheel_filter(
                wheel_runs.config(random_drive.drive, nodes), wheel_runs.tables(random_drive.drive)
            )
            numbers.append(wheel_runs.end_error(random_drive.drive, result) / random_drive.drive.length)
            numbers.append(wheel_runs.nees(random_drive.drive, result))
            implied[name].append(implied_errors(result, seed) / random_drive.drive.length)
            ratios[name].append(variance_ratios(random_drive.drive, result))
            has_slips = any(wheel.slip_detector.slips for wheel in result.filter.core.wheels)
            alarms[name] += has_slips and not random_drive.slips
        rows.append(numbers)
        kinds.append(["all", *_kinds(random_drive)])
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
    n_without_slip = sum("grips" in row for row in kinds)
    alarm_counts = ", ".join(f"{name} {count}" for name, count in alarms.items())
    print(f"of {n_without_slip} drives that grip, slip detected in: {alarm_counts}")
    medians = ", ".join(
        f"{name} {100 * np.median(table[:, k]):.2f} % (implied {100 * np.median(implied[name]):.2f} %)"
        for name, k in zip(NAMES, (1, 3), strict=True)
    )
    print(f"median error, and the one that the covariances imply: {medians}")
    _print_ratios(ratios)
    means = table[:, [2, 4]].mean(axis=0)
    held = bool(((means >= 0.7 * DEGREES) & (means <= 2.0 * DEGREES)).all())
    bounds = f"{0.7 * DEGREES:.1f} and {2 * DEGREES:.1f}"
    print(f"required: mean NEES of all between {bounds}: {'met' if held else 'missed'}")
    return int(not held)


def _print_ratios(ratios: dict[str, list[np.ndarray]]) -> None:
    for name, rows in ratios.items():
        radial, tangential, heading = np.mean(rows, axis=0)
        print(
            f"{name}: squared error / variance, 1 if consistent: distance from the start {radial:.2f}, "
            f"across {tangential:.2f}, heading {heading:.2f}"
        )


def _kinds(it: Drawn) -> list[str]:
    speeds = ((0.3, "below 0.3 m/s"), (3.0, "0.3 to 3 m/s"), (99.0, "above 3 m/s"))
    fast = next(words for limit, words in speeds if it.top_speed < limit)
    noisy = "noise above 3 times" if it.noise > 3.0 else "noise below 3 times"
    rested = "rests above 60 s" if it.rested > 60.0 else "rests below 60 s"
    return [fast, noisy, rested, "slips" if it.slips else "grips", "hilly" if it.hilly else "level"]


def _print(kind: str, table: np.ndarray) -> None:
    inside = chi2.ppf(0.95, DEGREES)
    cells = []
    for k in (1, 3):
        error, nees = 100.0 * np.median(table[:, k]), table[:, k + 1]
        cells.append(f"{error:8.2f} %{nees.mean():9.1f}{np.median(nees):7.1f}{np.mean(nees < inside):6.0%}")
    print(f"{kind:28s}{len(table):7d} {100 * np.median(table[:, 0]):7.1f} %   {'   '.join(cells)}")


if __name__ == "__main__":
    sys.exit(main())
