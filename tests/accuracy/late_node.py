"""Two wheels, the time stamps of one node late: error, NEES and the estimated delay on random drives.

    python tests/accuracy/late_node.py [--drives 20] [--first-seed 5000] [--late 0 0.01 0.02]

The drives are those of mixed.py. Vibration of a rolling wheel about its axle, rad/s, is the difference of
successive white angles: a wheel that shakes does not turn on the whole. Error at the end in % of the
distance; NEES of x, y and heading, 3 if consistent.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from generators.mixed_drives import drawn
from generators.wheel_drives import WheelDrive
from hubodo.fuse.wheel.entries import TIME_OFFSET
from hubodo.fuse.wheel.track import run_wheel_filter
from script_arguments import script_parser
from wheel_runs import config, end_error, nees, tables

MIN_ROLLING_RATE = 0.3  # rad/s; a slower wheel does not vibrate


def late_drive(seed: int, late: float, vibration: float) -> WheelDrive:
    """Return a random drive whose right node is late by `late` seconds, with vibration of both wheels."""
    drive, rng = drawn(seed).drive, np.random.default_rng([seed, 34])
    nodes = {}
    for name, node in drive.nodes.items():
        gyro, rolls = node.gyro.copy(), np.abs(node.gyro[:, 2]) > MIN_ROLLING_RATE
        angle = rng.standard_normal(np.count_nonzero(rolls) + 1)
        gyro[rolls, 2] += vibration * np.sqrt(0.5) * np.diff(angle)
        nodes[name] = replace(node, gyro=gyro, t=node.t + (late if name == "right" else 0.0))
    return replace(drive, nodes=nodes)


def main() -> int:
    """Print a line for each delay, without vibration and with it."""
    parser = script_parser(__doc__, drives=20, first_seed=5000)
    parser.add_argument("--late", type=float, nargs="+", default=(0.0, 0.01, 0.02), help="s")
    parser.add_argument("--vibration", type=float, default=0.2, help="rad/s")
    args = parser.parse_args()
    seeds = range(args.first_seed, args.first_seed + args.drives)
    print(f"seeds {seeds[0]} to {seeds[-1]}; delays in ms beside the clocks of the drives (0, 3 or 10 ms)")
    print(f"{'late':>6}{'vibration':>11}{'median':>9}{'mean':>8}{'NEES of 3':>11}{'delay':>8}{'sigma':>8}")
    for vibration in (0.0, args.vibration):
        for late in args.late:
            rows = []
            for seed in seeds:
                drive = late_drive(seed, late, vibration)
                run = run_wheel_filter(config(drive), tables(drive))
                delay = run.filter.core.estimate(None, TIME_OFFSET)
                error = 100.0 * end_error(drive, run) / drive.length
                rows.append((error, nees(drive, run), 1e3 * delay.value, 1e3 * delay.sigma))
            error, nees_values, delays, sigmas = np.array(rows).T
            print(
                f"{1e3 * late:6.0f}{vibration:11.2f}{np.median(error):9.3f}{error.mean():8.3f}"
                f"{nees_values.mean():11.2f}{np.median(delays):8.2f}{np.median(sigmas):8.2f}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
