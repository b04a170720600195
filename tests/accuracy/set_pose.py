"""Consistency of the live pose after another program has set it: NEES of the pose at the end of a drive.

    python tests/accuracy/set_pose.py [--seeds 60] [--first 720]

A drive of 21 m; see `tests/set_pose_runs.py`. A consistent pose has a mean NEES of 3.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from script_arguments import script_parser
from set_pose_runs import pose_nees


def main():
    parser = script_parser(__doc__, seeds=60, first=720)
    args = parser.parse_args()
    values = np.array([pose_nees(seed) for seed in range(args.first, args.first + args.seeds)])
    inside = np.mean(values < chi2.ppf(0.95, 3))
    seeds = f"seeds {args.first} to {args.first + args.seeds - 1}"
    print(f"{seeds}: mean NEES {values.mean():.2f} of 3 degrees of freedom,")
    print(f"  {inside:.0%} of the poses inside their 95 % ellipsoid, largest {values.max():.1f}")


if __name__ == "__main__":
    main()
