"""Outages of seconds while driving: error that they add, and consistency of the sigmas.

    python tests/accuracy/dropouts.py [--drives 200] [--seed 3000]

Each drive draws a speed of 0.3 to 3 m/s, an outage of all nodes of 0.5 to 5 s in it, straight or in a turn,
and every second one another speed and yaw rate from the middle of the outage on. The errors are those of the
pose two seconds after the outage minus those before it; NEES of x, y and heading: 3 if consistent. A position
is covered if its error is within 0.3 m or within three sigmas.

With one wheel nothing measures the yaw rate meanwhile: the angle of the wheel shows a path, which any change
of the heading is compatible with. What is left is how fast yaw rates usually change between the known ones
before and after. The last lines give the 1 sigma of the turn of such a process (Ornstein-Uhlenbeck, 0.35
rad/s, 2 s), which no estimator can better, and the shares of errors within one and two stated sigmas (68 and
95 % if consistent).
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
        heading, sigma = rows[:, 3], rows[:, 4]
        shares = [np.mean(heading < factor * sigma) for factor in (1.0, 2.0)]
        print(f"  {len(names)} wheels, heading: {shares[0]:.0%} within 1 sigma, {shares[1]:.0%} within 2")
    bounds = ", ".join(f"{t:g} s {np.degrees(turn_bound(t)):.1f}°" for t in (0.5, 1.0, 2.0, 3.0, 5.0))
    print(f"  1 sigma of a turn between known yaw rates: {bounds}")
    return 0


def turn_bound(seconds: float, sigma: float = 0.35, time: float = 2.0) -> float:
    """Return the 1 sigma of the turn, rad, of a yaw rate that is known only before and after `seconds`.

    sigma, time: rad/s and s, of the stationary Ornstein-Uhlenbeck process that the yaw rate is.
    """
    t = np.linspace(0.0, seconds, 401)
    covariance = sigma**2 * np.exp(-np.abs(t[:, None] - t) / time)
    weight = np.full(len(t), t[1])
    weight[[0, -1]] *= 0.5
    with_ends = (covariance @ weight)[[0, -1]]
    ends = covariance[np.ix_([0, -1], [0, -1])]
    return float(np.sqrt(weight @ covariance @ weight - with_ends @ np.linalg.solve(ends, with_ends)))


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
