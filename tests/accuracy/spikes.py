"""Spikes in all channels of both nodes: error and consistency of the sigmas, left in and replaced.

    python tests/accuracy/spikes.py [--drives 12] [--seed 9100]

Loops of 120 m at up to 5 m/s; the given share of the values of each channel is drawn from the whole range of
the sensor. NEES of x, y and heading at the end: 3 if consistent.
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
from generators.spikes import with_spikes
from hubodo.fuse.spikes import remove_spikes
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.recording import Recording
from script_arguments import script_parser
from wheel_runs import BOTH, config, end_error, nees, tables

SHARES = (0.0, 1e-4, 1e-3, 1e-2)


def main() -> int:
    """Print a line for each share of spikes, with one wheel and with two."""
    parser = script_parser(__doc__, drives=12, seed=9100)
    args = parser.parse_args()
    seeds = range(args.seed, args.seed + args.drives)
    print(f"{args.drives} drives, seeds {seeds[0]} to {seeds[-1]}: median error in %, mean NEES of 3")
    for names in (("left",), BOTH):
        for share in SHARES:
            rows = np.array([_run(seed, names, share) for seed in seeds])
            error, mean = 100.0 * np.median(rows[:, :, 0], axis=0), rows[:, :, 1].mean(axis=0)
            print(
                f"  {len(names)} wheels, {share:.2%} of the values: left in {error[0]:.2f} %, {mean[0]:.1f}; "
                f"replaced {error[1]:.2f} %, {mean[1]:.1f}",
                flush=True,
            )
    return 0


def _run(seed: int, names: tuple[str, ...], share: float) -> list[tuple[float, float]]:
    """Return the error at the end as a share of the path, and NEES: with spikes, and with them replaced."""
    rng = np.random.default_rng(seed)
    drive = wheel_drives.drive(wheel_drives.loop(rng, 120.0, 5.0), rng)
    spiked = with_spikes(tables(drive), share, seed)
    results = []
    for nodes in (spiked, remove_spikes(Recording(spiked), names)[0].nodes):
        run = run_wheel_filter(config(drive, names), nodes)
        results.append((end_error(drive, run) / drive.length, nees(drive, run)))
    return results


if __name__ == "__main__":
    sys.exit(main())
