"""Nodes on a rim beyond the range of the IMU's accelerometer: error at the end and NEES.

python tests/accuracy/rim.py [--drives 20] [--seed 500]

Each drive is run with the IMU of 16 g alone, with a second accelerometer of 200 g, and with an IMU of 200 g,
which is the best that a second chip can do.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from generators.rim_drives import IMU_RANGE, WIDE, RimDrive, rim_drive
from hubodo.fuse.range_extension import extend_table
from hubodo.fuse.ranges import uncorrected_accel_limit
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.recording import Table
from script_arguments import script_parser
from wheel_runs import BOTH, config, end_error, nees

LIMIT, WIDE_LIMIT = uncorrected_accel_limit(IMU_RANGE), uncorrected_accel_limit(WIDE.accel)
GYRO_LIMIT = 0.998 * WIDE.gyro


def records(rim: RimDrive) -> dict[str, tuple[dict[str, Table], float]]:
    """Return tables by node and the accelerometer's limit, m/s², by the sensors of the node."""
    wide = {
        name: Table({**table.columns, **dict(zip(("ax", "ay", "az"), rim.wide[name].T, strict=True))})
        for name, table in rim.nodes.items()
    }
    extended = {name: extend_table(table, rim.chips[name], LIMIT) for name, table in rim.nodes.items()}
    return {"16 g": (rim.nodes, LIMIT), "and 200 g": (extended, LIMIT), "IMU of 200 g": (wide, WIDE_LIMIT)}


def main() -> int:
    """Print a line for each speed, direction of the lever arm, number of wheels and set of sensors."""
    parser = script_parser(__doc__, drives=20, seed=500)
    args = parser.parse_args()
    print(f"seeds {args.seed} to {args.seed + args.drives - 1}; error at the end, % of the distance")
    for speed, degrees in ((14.0, 45.0), (20.0, 45.0), (20.0, 0.0)):
        results: dict[tuple[str, int], list[tuple[float, float]]] = {}
        for seed in range(args.seed, args.seed + args.drives):
            rim = rim_drive(speed, np.radians(degrees), seed)
            for sensors, (tables, limit) in records(rim).items():
                limits = {"gyro_limit": GYRO_LIMIT, "accel_limit": limit}
                for names in (("left",), BOTH):
                    run = run_wheel_filter(config(rim.drive, names, limits=limits), tables)
                    row = 100.0 * end_error(rim.drive, run) / rim.drive.length, nees(rim.drive, run)
                    results.setdefault((sensors, len(names)), []).append(row)
        for (sensors, wheels), rows in results.items():
            error, value = np.array(rows).T
            print(
                f"{speed:4.0f} m/s, {degrees:2.0f}°, {wheels} wheel(s), {sensors:12}: "
                f"median {np.median(error):6.2f}, largest {error.max():7.2f}; NEES of 3 {value.mean():6.2f}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
