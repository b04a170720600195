"""Outages of seconds while driving: error that they add, and consistency of the sigmas.

    python tests/accuracy/dropouts.py [--drives 200] [--seed 3000]

Each drive draws a speed of 0.3 to 3 m/s, an outage of all nodes of 0.5 to 5 s in it, straight or in a turn,
and every second one another speed and yaw rate from the middle of the outage on. The errors are those of the
pose two seconds after the outage minus those before it; NEES of x, y and heading: 3 if consistent. A position
is covered if its error is within 0.3 m or within three sigmas.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from generators.outages import random_outage
from hubodo.fuse.wheel.track import run_wheel_filter
from script_arguments import script_parser
from wheel_runs import BOTH, config, pose_error, tables

GROUPS = {"up to 1 s": (0.0, 1.0), "1 to 3 s": (1.0, 3.0), "3 to 5 s": (3.0, 5.0), "all": (0.0, 5.0)}


def main() -> int:
    """Print a line for each length of outage, with one wheel and with two."""
    parser = script_parser(__doc__, drives=200, seed=3000)
    args = parser.parse_args()
    print(f"outages of all nodes, seeds {args.seed} to {args.seed + args.drives - 1}; errors that they add")
    for names in (BOTH, ("left",)):
        rows = np.array([_run(seed, names) for seed in range(args.seed, args.seed + args.drives)])
        for group, (shortest, longest) in GROUPS.items():
            inside = rows[(rows[:, 0] > shortest) & (rows[:, 0] <= longest)]
            if len(inside):
                _print(f"{len(names)} wheels, {group}", inside)
    return 0


def _run(seed: int, names: tuple[str, ...]) -> tuple[float, ...]:
    """Return length of the outage, s, position error, m, its sigma, heading error, rad, its sigma, NEES."""
    drive, start, end = random_outage(seed)
    track = run_wheel_filter(config(drive, names), tables(drive)).track
    before, after = (int(np.searchsorted(track.t, t)) for t in (start - 0.1, end + 2.0))
    error, covariance = pose_error(drive, track, after)
    error = error - pose_error(drive, track, before)[0]
    position_sigma = float(np.sqrt(np.trace(covariance[:2, :2])))
    return (
        end - start,
        float(np.hypot(*error[:2])),
        position_sigma,
        abs(float(error[2])),
        float(np.sqrt(covariance[2, 2])),
        float(error @ np.linalg.solve(covariance, error)),
    )


def _print(label: str, rows: np.ndarray) -> None:
    _, error, sigma, heading, heading_sigma, nees = rows.T
    within = error < 0.3
    covered = within | (error < 3.0 * sigma)
    degrees = np.degrees(np.median([heading, heading_sigma], axis=1))
    print(
        f"  {label:20} {len(rows):4d}: median {np.median(error):5.2f} m, {degrees[0]:5.2f}°; "
        f"within 0.3 m {within.mean():4.0%}, covered {covered.mean():4.0%}; heading within 1° "
        f"{(heading < np.radians(1.0)).mean():4.0%}, median sigma {degrees[1]:5.2f}°; "
        f"NEES {nees.mean():5.2f}, largest {nees.max():6.1f}",
        flush=True,
    )


if __name__ == "__main__":
    sys.exit(main())
