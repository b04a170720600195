"""Gyros of a node with related and with independent scale errors: error and consistency of heading.

    python tests/accuracy/scales.py [--drives 20] [--seed 900]

The filter expects that the three gyros of a chip share a part of their scale error. Nodes of three kinds
drive loops that turn once: scale errors of 1 % that are strongly, half and not correlated. NEES of
x, y and heading at the end: 3 if consistent.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from generators import wheel_drives
from hubodo.fuse.wheel.track import run_wheel_filter
from script_arguments import script_parser
from wheel_runs import BOTH, config, end_error, nees, tables

KINDS = {
    "correlation 0.95": 0.95,
    "correlation 0.5": 0.5,
    "independent": 0.0,
}
LENGTH = 120.0


def main() -> int:
    """Print a line for each kind of node, with one wheel and with two."""
    parser = script_parser(__doc__, drives=20, seed=900)
    args = parser.parse_args()
    print(f"loops of {LENGTH:g} m, seeds {args.seed} to {args.seed + args.drives - 1}; at the end:")
    for kind, correlation in KINDS.items():
        rows: dict[tuple[str, ...], list[tuple[float, float, float]]] = {("left",): [], BOTH: []}
        for seed in range(args.seed, args.seed + args.drives):
            rng = np.random.default_rng(seed)
            plan = wheel_drives.loop(rng, LENGTH, 5.0)
            drive = wheel_drives.drive(plan, rng, wheel_drives.Errors(scale_correlation=correlation))
            for names, results in rows.items():
                run = run_wheel_filter(config(drive, names), tables(drive))
                heading = np.degrees(run.track.heading[-1] - drive.heading[-1])
                results.append((100.0 * end_error(drive, run) / drive.length, heading, nees(drive, run)))
        for names, results in rows.items():
            error, heading, nees_values = np.array(results).T
            print(
                f"  {kind:16} {len(names)} wheels: median {np.median(error):5.2f} %, heading rms "
                f"{np.sqrt(np.mean(heading**2)):5.2f}°, NEES {nees_values.mean():5.2f} of 3",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
