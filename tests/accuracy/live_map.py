"""Live map: loops of 120 m with fixes of 5 m at 5 Hz; each pose is scored as published.

    python tests/accuracy/live_map.py [DRIVES [FIRST_SEED]]

Fixes arrive 0.15 s late. Half of the drives are repeated with fixes displaced by 100 m for 8 s and an outage
of 20 s. NEES: squared error of x, y and heading over their covariance, 3 if consistent.
"""

import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators import gnss_drives
from hubodo.fuse.graph.live import LiveGraph

SIGMA, LATE = 5.0, 0.15
JUMP, OUTAGE = (50.0, 58.0), (70.0, 90.0)


def run_drive(seed, faulty):
    """Return rms error, m, rms heading error, deg, largest error, m, final NEES, and CPU time per fix, s."""
    rng = np.random.default_rng([seed, 46])
    drive = gnss_drives.drive(rng, gnss_drives.loop(rng, length=120.0), sigma=SIGMA)
    jumped = faulty & (drive.fix_t > JUMP[0]) & (drive.fix_t < JUMP[1])
    latitude, _ = gnss_drives.geodetic(0.0, 100.0 * jumped, drive.fix_latitude_deg, drive.fix_longitude_deg)
    missing = faulty & (drive.fix_t > OUTAGE[0]) & (drive.fix_t < OUTAGE[1])
    fixes = list(
        zip(drive.fix_t[~missing], latitude[~missing], drive.fix_longitude_deg[~missing], strict=True)
    )
    count, began = len(fixes), time.process_time()
    graph, errors = LiveGraph(), []
    for t, *pose in zip(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading, strict=True):
        graph.add_odometry(t, *pose)
        while fixes and fixes[0][0] + LATE <= t:
            graph.add_fix(*fixes.pop(0), SIGMA)
        state = graph.state()
        if state is not None:
            ox, oy = state.frame.to_local(*gnss_drives.geodetic(0.0, 0.0, *drive.origin))
            x, y, heading = drive.truth(t)
            heading_error = np.mod(state.heading - heading + np.pi, 2.0 * np.pi) - np.pi
            errors.append([state.x - ox - x, state.y - oy - y, heading_error])
    used = time.process_time() - began
    error = np.array(errors)
    distance = np.hypot(error[:, 0], error[:, 1])
    nees = error[-1] @ np.linalg.solve(state.covariance, error[-1])
    return (
        np.sqrt(np.mean(distance**2)),
        np.degrees(np.sqrt(np.mean(error[:, 2] ** 2))),
        distance.max(),
        nees,
        used / count,
    )


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    drives = int(arguments[0]) if arguments else 20
    first = int(arguments[1]) if len(arguments) > 1 else 0
    missed = []
    for faulty, number in ((False, drives), (True, (drives + 1) // 2)):
        rows = np.array([run_drive(seed, faulty) for seed in range(first, first + number)])
        label = "a jump and an outage" if faulty else "fixes all the way"
        print(f"{label}: {number} loops of 120 m, seeds {first}..{first + number - 1}")
        names = ("rms m", "rms heading, deg", "worst m", "NEES at the end", "CPU ms a fix")
        for name, values in zip(names, (rows * [1.0, 1.0, 1.0, 1.0, 1e3]).T, strict=True):
            print(f"  {name:18} median {np.median(values):6.2f}, 90 % {np.quantile(values, 0.9):6.2f}, "
                  f"largest {values.max():6.2f}, mean {values.mean():6.2f}")  # fmt: skip
        low, high = chi2.ppf([0.0005, 0.9995], 3 * number) / number
        if not low < rows[:, 3].mean() < high:
            missed.append(f"NEES within {low:.2f} to {high:.2f} ({label})")
        if np.median(rows[:, 0]) > 1.0:
            missed.append(f"median rms at most 1.0 m ({label})")
    print(f"claims: {missed or 'all met'}")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
