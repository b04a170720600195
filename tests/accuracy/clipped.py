"""Clipped sensors: final error in % of the distance, and consistency of the sigmas.

python tests/accuracy/clipped.py [--drives 20] [--seed 100] [--cases "20 m/s" ...]

NEES: squared error of x, y and heading over their covariance, mean over the drives, 3 if consistent. The
baseline is plain differential odometry from the same two saturated gyros.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from accuracy.mixed import differential_odometry_error
from generators.clipped_drives import CASES, clipped_drive
from hubodo.fuse.wheel.track import run_wheel_filter
from script_arguments import script_parser
from wheel_runs import BOTH, config, end_error, nees, tables

WHEELS = {"one": ("left",), "two": BOTH}


def main() -> int:
    """Print a line for each case, with one wheel and with two."""
    parser = script_parser(__doc__, drives=20, seed=100)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    args = parser.parse_args()
    print(f"seeds {args.seed} to {args.seed + args.drives - 1}; error at the end, % of the distance")
    print(f"{'':28}{'wheels':>7}{'median':>9}{'largest':>9}{'dist.':>8}{'NEES of 3':>11}{'largest':>9}")
    for name in args.cases:
        rows: dict[str, list[tuple[float, float, float]]] = {key: [] for key in WHEELS}
        baseline = []
        for seed in range(args.seed, args.seed + args.drives):
            drive = clipped_drive(CASES[name], seed)
            baseline.append(100.0 * differential_odometry_error(drive, not CASES[name].begins) / drive.length)
            for key, names in WHEELS.items():
                result = run_wheel_filter(config(drive, names, limits=CASES[name].limits), tables(drive))
                distance = abs(result.report.distance / drive.length - 1.0)
                error = end_error(drive, result) / drive.length
                rows[key].append((100.0 * error, 100.0 * distance, nees(drive, result)))
        for key, results in rows.items():
            error, distance, nees_values = np.array(results).T
            print(
                f"{name:28}{key:>7}{np.median(error):9.2f}{error.max():9.2f}{np.median(distance):8.2f}"
                f"{nees_values.mean():11.2f}{nees_values.max():9.1f}",
                flush=True,
            )
        print(f"{name:28}{'plain':>7}{np.median(baseline):9.2f}{max(baseline):9.2f}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
