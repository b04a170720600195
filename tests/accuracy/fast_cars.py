"""Fast cars with ±2000 °/s and ±16 g, by speed and by how far off the axle the sensor is.

    python tests/accuracy/fast_cars.py [--drives 6] [--seed 300] [--speeds 10 20 35] [--arms 0 0.05]

Wheels of 0.3 m, track 1.4 m: the gyro about the axle is beyond its range from 10.5 m/s on, an accelerometer
across the axle on an arm a from 0.3 m √(147 m/s² / a) on. The arm is along the x axis of the node, so its y
axis stays in range; with --diagonal it is halfway between both axes, and both clip from 1.19 times that speed
on. Error at the end in % of the distance; NEES of x, y and heading, 3 if consistent.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from generators.clipped_drives import Clipped, clipped_drive
from hubodo.fuse.wheel.track import run_wheel_filter
from script_arguments import script_parser
from wheel_runs import BOTH, config, end_error, nees, tables

WHEELS = {"one": ("left",), "two": BOTH}
SPEEDS, ARMS = (10.0, 15.0, 20.0, 25.0, 35.0), (0.0, 0.02, 0.05, 0.15)


def main() -> int:
    """Print a line for each speed and arm, with one wheel and with two."""
    parser = script_parser(__doc__, drives=6, seed=300)
    parser.add_argument("--speeds", type=float, nargs="+", default=SPEEDS, help="m/s")
    parser.add_argument("--arms", type=float, nargs="+", default=ARMS, help="m off the axle")
    parser.add_argument("--diagonal", action="store_true", help="arm halfway between both axes of the node")
    args = parser.parse_args()
    print(f"seeds {args.seed} to {args.seed + args.drives - 1}; error at the end, % of the distance")
    print(f"{'m/s':>5}{'arm, m':>8}{'wheels':>8}{'median':>9}{'largest':>9}{'NEES of 3':>11}{'largest':>9}")
    for speed in args.speeds:
        for arm in args.arms:
            rows: dict[str, list[tuple[float, float]]] = {key: [] for key in WHEELS}
            for seed in range(args.seed, args.seed + args.drives):
                # The generator accepts no arm of length zero: a tenth of a millimetre is used.
                size = max(arm, 1e-4)
                along_axes = (size * 0.5**0.5, size * 0.5**0.5) if args.diagonal else (size, 0.0)
                case = Clipped(speed, radius=0.3, track=1.4, rate_hz=208.0, arm=along_axes)
                drive = clipped_drive(case, seed)
                for key, names in WHEELS.items():
                    run = run_wheel_filter(config(drive, names, limits=case.limits), tables(drive))
                    rows[key].append((100.0 * end_error(drive, run) / drive.length, nees(drive, run)))
            for key, results in rows.items():
                error, nees_values = np.array(results).T
                print(
                    f"{speed:5.0f}{arm:8.2f}{key:>8}{np.median(error):9.2f}{error.max():9.2f}"
                    f"{nees_values.mean():11.1f}{nees_values.max():9.1f}",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
