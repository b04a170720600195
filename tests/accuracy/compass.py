"""Loops of 250 m with a compass on a vehicle with iron: the track compared with that of the wheels alone.

    python tests/accuracy/compass.py [DRIVES [FIRST_SEED]]

Nodes and compass come from tests/generators, which share no code with filter and graph. The start pose is
known. The compass is declared with 0.05 rad, and with its true noise of 0.028 rad. For each kind of iron:
error of the position at the end, NEES of the last pose (3 dof) over its dimensions and of its heading alone,
and the drives in which the compass moved the end away from the truth by more than a sigma.
"""

import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import wheel_runs
from generators import compass, wheel_drives
from hubodo.fuse.fusion import fuse_outside_sensors
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.recording import Recording, Table
from hubodo.vehicle import load_vehicle
from vehicles import vehicle_toml

CASES = {
    "no iron": compass.Iron(),
    **{f"hard iron {size:.0%}": compass.Iron(hard=size) for size in (0.05, 0.2, 0.4, 0.6)},
    "soft iron 10%": compass.Iron(soft=0.1),
    "hard 20%, soft 10%": compass.Iron(hard=0.2, soft=0.1),
    "beside the road 30%": compass.Iron(disturbance=0.3, share=0.3),
    "the same, hard 30%": compass.Iron(hard=0.3, disturbance=0.3, share=0.3),
}
DECLARED_SIGMAS = (0.05, 0.028)


def run_odometry(drive, names):
    """Return the wheel odometry of a drive by the nodes `names`, and its truth."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vehicle.toml"
        path.write_text(vehicle_toml(drive.radius, drive.track, facing=dict.fromkeys(names, "left")))
        vehicle = load_vehicle(path)
    truth = Table(
        {"t": drive.t[::10], "x": drive.x[::10], "y": drive.y[::10], "heading": drive.heading[::10]}
    )
    tables = wheel_runs.tables(drive)
    recording = Recording({name: tables[name] for name in names}, truth=truth)
    return compute_wheel_odometry(recording, vehicle, log="loop"), truth


def score_end(track, truth):
    """Return the position error at the end, m, the NEES of the last pose over 3, the sigma, m, and that of
    the heading alone."""
    at_end, at_start = (
        [np.interp(t, truth.t, truth[name]) for name in ("x", "y", "heading")] for t in track.t[[-1, 0]]
    )
    error = np.array(
        [
            track.x[-1] - track.x[0] - at_end[0] + at_start[0],
            track.y[-1] - track.y[0] - at_end[1] + at_start[1],
            np.mod(track.heading[-1] - at_end[2] + np.pi, 2.0 * np.pi) - np.pi,
        ]
    )
    covariance = np.diag([track.sigma_x[-1] ** 2, track.sigma_y[-1] ** 2, track.sigma_heading[-1] ** 2])
    for (i, j), values in zip(
        ((0, 1), (0, 2), (1, 2)), (track.cov_xy, track.cov_x_heading, track.cov_y_heading), strict=True
    ):
        covariance[i, j] = covariance[j, i] = values[-1]
    return (
        np.hypot(error[0], error[1]),
        error @ np.linalg.solve(covariance, error) / 3.0,
        np.hypot(track.sigma_x[-1], track.sigma_y[-1]),
        error[2] ** 2 / covariance[2, 2],
    )


def print_rows(title, rows, corrected, rejected):
    """Print a table, and return a line for each row that is worse than without compass, or too sure."""
    missed = []
    print(
        f"  {'':22}{'end error, m':>14}{'largest':>9}{'NEES/3':>8}{'heading':>9}"
        f"{'worse':>7}{'iron':>6}{'rejected':>10}"
    )
    reference = np.array(rows["without compass"])
    limit = np.sqrt(np.mean(reference[:, 0] ** 2))
    for name, values in rows.items():
        error, nees, sigma, heading = np.array(values).T
        worse = int(np.sum(error - reference[:, 0] > sigma))
        rms = np.sqrt(np.mean(error**2))
        print(
            f"  {name:22}{rms:14.2f}{error.max():9.2f}{nees.mean():8.2f}{heading.mean():9.2f}{worse:7}"
            f"{corrected.get(name, 0):6}{rejected.get(name, 0):10}",
            flush=True,
        )
        if rms > limit or heading.mean() > 2.0:
            missed.append(f"{title}, {name}: {rms:.2f} m, NEES of heading {heading.mean():.2f}")
    return missed


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    drives = int(arguments[0]) if arguments else 20
    first = int(arguments[1]) if len(arguments) > 1 else 0
    missed = []
    for names in (("left", "right"), ("left",)):
        parts = {sigma: ({}, {}, {}) for sigma in DECLARED_SIGMAS}
        for seed in range(first, first + drives):
            rng = np.random.default_rng([seed, 71])
            odometry, truth = run_odometry(wheel_drives.drive(wheel_drives.loop(rng), rng), names)
            for rows, *_ in parts.values():
                rows.setdefault("without compass", []).append(score_end(odometry.track, truth))
            t = np.arange(0.1, truth.t[-1], 0.1)
            for k, (name, iron) in enumerate(CASES.items()):
                rng = np.random.default_rng([seed, 72, k])
                shown = compass.headings(rng, t, np.interp(t, truth.t, truth["heading"]), iron)
                for declared, (rows, corrected, rejected) in parts.items():
                    headings = Table({"t": t, "heading": shown, "sigma": np.full(len(t), declared)})
                    result = fuse_outside_sensors(Recording({}, truth=truth, heading=headings), odometry)
                    rows.setdefault(name, []).append(score_end(result.from_start, truth))
                    for count, text in ((corrected, "corrected"), (rejected, "not used")):
                        count[name] = count.get(name, 0) + any(text in line for line in result.warnings)
        for declared, (rows, corrected, rejected) in parts.items():
            title = f"nodes {' and '.join(names)}, declared sigma {declared} rad"
            print(f"{title}: {drives} loops of 250 m, seeds {first}..{first + drives - 1}, headings at 10 Hz")
            missed += print_rows(title, rows, corrected, rejected)
    for line in missed:
        print(f"missed: {line}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
