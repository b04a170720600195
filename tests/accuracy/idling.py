"""Engines that idle at standstill: false motion, false biases and slips, and the error of the drive after it.

    python tests/accuracy/idling.py [--drives 36] [--first-seed 7000]

A car stands for 13 s with its engine running, drives half a minute, and stands with it running again. The
engine shakes the hub at its firing frequency (two per turn, with the harmonic and the half order) and rocks
the body; sampling aliases it. Idle speed 600 to 3000 rpm, 0.5 to 5 m/s² rms, 50 to 416 Hz. A drive diverges
if its error at the end exceeds 10 % of the distance, its NEES of 3 exceeds 30, or a slip is reported.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from generators.idling import idling_drive
from hubodo.fuse.wheel.track import run_wheel_filter
from script_arguments import script_parser
from wheel_runs import BOTH, config, end_error, nees, tables

WHEELS = {"one": ("left",), "two": BOTH}
MAX_ERROR_PERCENT, MAX_NEES = 10.0, 30.0


def main() -> int:
    """Print a line for each number of wheels; return 1 if a drive diverges."""
    parser = script_parser(__doc__, drives=36, first_seed=7000)
    parser.add_argument("--each", action="store_true", help="a line for each drive")
    args = parser.parse_args()
    seeds = range(args.first_seed, args.first_seed + args.drives)
    rows: dict[str, list[tuple[float, float, int]]] = {key: [] for key in WHEELS}
    for seed in seeds:
        case, drive = idling_drive(seed)
        for key, names in WHEELS.items():
            run = run_wheel_filter(config(drive, names), tables(drive))
            error = 100.0 * end_error(drive, run) / drive.length
            slips = sum(len(wheel.slip_detector.slips) for wheel in run.filter.core.wheels)
            rows[key].append((error, nees(drive, run), slips))
            if args.each:
                print(
                    f"{seed} {case} {key}: {error:.2f} %, NEES {rows[key][-1][1]:.1f}, slips {slips}",
                    flush=True,
                )
    print(f"seeds {seeds[0]} to {seeds[-1]}; error at the end, % of the distance")
    print(
        f"{'wheels':>7}{'median':>9}{'largest':>9}{'NEES of 3':>11}{'largest':>9}{'slips':>7}{'diverged':>10}"
    )
    n_diverged = 0
    for key, results in rows.items():
        error, nees_values, slips = np.array(results).T
        diverged = int(np.sum((error > MAX_ERROR_PERCENT) | (nees_values > MAX_NEES) | (slips > 0)))
        n_diverged += diverged
        print(
            f"{key:>7}{np.median(error):9.2f}{error.max():9.2f}{nees_values.mean():11.2f}"
            f"{nees_values.max():9.1f}{int(slips.sum()):7d}{diverged:10d}"
        )
    return int(n_diverged > 0)


if __name__ == "__main__":
    sys.exit(main())
