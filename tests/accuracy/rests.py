"""Standstill: error after a standstill of any length, with a noisy gyro or an idling engine.

python tests/accuracy/rests.py [--drives 4] [--seed 40] [--rests 5 60 600 1800]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from generators.standstills import drive_with_standstill  # noqa: E402
from hubodo.fuse.wheel.track import run_wheel_filter  # noqa: E402
from script_arguments import script_parser  # noqa: E402
from wheel_runs import config, end_error, nees, tables  # noqa: E402

KINDS = {"0.002 rad/s of noise": (0.002, 0.0), "0.02 rad/s": (0.02, 0.0), "idling, 0.03 rad/s": (0.002, 0.03)}
LENGTH = 150.0


def main() -> int:
    """Print a line for each kind, position and length of the standstill."""
    parser = script_parser(__doc__, drives=4, seed=40)
    parser.add_argument("--rests", type=float, nargs="+", default=[5.0, 60.0, 600.0, 1800.0])
    args = parser.parse_args()
    print(
        f"loops of {LENGTH:g} m, two nodes, seeds {args.seed} to {args.seed + args.drives - 1}; at the end:"
    )
    for kind, (noise, idling) in KINDS.items():
        for where in ("start", "middle"):
            for duration in args.rests:
                results = []
                for seed in range(args.seed, args.seed + args.drives):
                    drive = drive_with_standstill(seed, LENGTH, duration, where, noise, idling)
                    run = run_wheel_filter(config(drive), tables(drive))
                    results.append((100.0 * end_error(drive, run) / drive.length, nees(drive, run)))
                errors, nees_values = np.array(results).T
                print(
                    f"  {kind:22} {where:7} {duration:6.0f} s: median {np.median(errors):5.2f} %, largest "
                    f"{errors.max():5.2f} %, NEES {nees_values.mean():5.2f} of 3",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
