"""A real car with fixes of 5 m at 5 Hz: the graph beside the fixes alone, in drives and in outages.

    python tests/accuracy/car_gnss.py [SEEDS [FIRST_SEED]]

The fixes are the RTK reference with white noise; the odometry is that of the car with the vehicle file, or
degraded by noise of each step or by a random walk of the yaw rate. NEES: squared error of x and y in units of
sigma, 2 if consistent. "none estimated": with the configured odometry noise instead of the estimated one.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from accuracy.car import SETS, drives, truth_of, with_nodes  # noqa: E402
from generators import gnss_drives  # noqa: E402
from hubodo.fuse.graph.batch import Fixes, GraphConfig, fuse_graph  # noqa: E402
from hubodo.fuse.track import Track  # noqa: E402
from hubodo.fuse.wheel.config import wheel_config  # noqa: E402
from hubodo.fuse.wheel.track import run_wheel_filter  # noqa: E402
from hubodo.fuse.wheel_odometry import graph_constant_sigmas  # noqa: E402

SIGMA, RATE_HZ, OUTAGE = 5.0, 5.0, 60.0
ORIGIN = (47.37, 8.54)
WORSE = {
    "as it is": (0.0, 0.0, 0.0),
    "steps of 0.1 m, 2 mrad per root of a metre": (0.1, 2e-3, 0.0),
    "yaw rate with a random walk of 0.5 mrad/s per root of a second": (0.0, 0.0, 5e-4),
}


def paths(sets=SETS):
    """Return (drive, nodes) -> odometry, prior sigmas of its constants, truth."""
    result = {}
    for name, log in drives().items():
        for names in sets:
            if set(names) <= set(log.nodes):
                output = run_wheel_filter(wheel_config(with_nodes(names), list(names)), log.nodes)
                track = output.track
                path = Track(track.t, track.x, track.y, track.heading)
                result[name, names] = (path, graph_constant_sigmas(output), truth_of(log))
    return result


def degrade_odometry(path, rng, step, heading, walk):
    """Return the odometry with added step noise (m and rad per √m) and a random walk of the yaw rate."""
    position, heading_angle, dt = path.x + 1j * path.y, np.unwrap(path.heading), np.diff(path.t)
    distance = np.diff(position) * np.exp(-0.5j * (heading_angle[1:] + heading_angle[:-1]))
    root_length, noise = np.sqrt(np.abs(distance)), rng.standard_normal((4, len(distance)))
    distance = distance + step * root_length * (noise[0] + 0.5j * noise[1])
    turn = (
        np.diff(heading_angle)
        + heading * root_length * noise[2]
        + np.cumsum(walk * np.sqrt(dt) * noise[3]) * dt
    )
    heading_angle = heading_angle[0] + np.append(0.0, np.cumsum(turn))
    position = position[0] + np.append(
        0.0, np.cumsum(distance * np.exp(0.5j * (heading_angle[1:] + heading_angle[:-1])))
    )
    return Track(path.t, position.real, position.imag, heading_angle)


def fuse_drive(path, constants, truth, seed, outage, estimated=True):
    """Return rms error, m, and NEES over the drive or its outage, and rms error of the fixes, m."""
    rng = np.random.default_rng([seed, 61])
    start, end = max(path.t[0], truth.t[0]), min(path.t[-1], truth.t[-1])
    t = np.arange(start, end, 1.0 / RATE_HZ)
    noise = SIGMA * rng.standard_normal((2, len(t)))
    east, north = (np.interp(t, truth.t, truth[name]) + n for name, n in zip("xy", noise, strict=True))
    outage_start = start + rng.uniform(0.3, 0.5) * (end - start)
    received = (t < outage_start) | (t > outage_start + outage)
    fixes = Fixes(t[received], *gnss_drives.geodetic(east[received], north[received], *ORIGIN))
    config = GraphConfig(constants=constants, inflate_sigmas=estimated)
    result = fuse_graph(path, fixes, None, config)
    ox, oy = result.frame.to_local(*gnss_drives.geodetic(np.zeros(1), np.zeros(1), *ORIGIN))
    track = result.track
    inside = (track.t >= start) & (track.t <= end)
    if outage:
        inside &= (track.t > outage_start) & (track.t < outage_start + outage)
    ex = (track.x - ox - np.interp(track.t, truth.t, truth["x"]))[inside]
    ey = (track.y - oy - np.interp(track.t, truth.t, truth["y"]))[inside]
    nees = np.mean((ex / track.sigma_x[inside]) ** 2 + (ey / track.sigma_y[inside]) ** 2)
    return np.sqrt(np.mean(ex**2 + ey**2)), nees, np.sqrt(np.mean(np.sum(noise**2, axis=0)))


def main(argv=None):
    """Print a line for each kind of odometry, for whole drives and for outages."""
    arguments = sys.argv[1:] if argv is None else argv
    seeds = int(arguments[0]) if arguments else 6
    first = int(arguments[1]) if len(arguments) > 1 else 0
    target = paths()
    print(f"{len(target)} drives and sets of nodes, seeds {first}..{first + seeds - 1}, "
          f"fixes of {SIGMA:g} m at {RATE_HZ:g} Hz; means of rms m and NEES (2 is true)")  # fmt: skip
    missed = []
    for label, errors in WORSE.items():
        for outage in (0.0, OUTAGE):
            rows = []
            for path, constants, truth in target.values():
                for seed in range(first, first + seeds):
                    degraded = degrade_odometry(path, np.random.default_rng([seed, 62]), *errors)
                    with_estimate = fuse_drive(degraded, constants, truth, seed, outage)
                    rows.append(
                        [
                            *with_estimate,
                            *fuse_drive(degraded, constants, truth, seed, outage, estimated=False)[:2],
                        ]
                    )
            rms, nees, fixes_rms, rms_before, nees_before = np.mean(rows, axis=0)
            where = f"outage of {outage:g} s" if outage else "whole drive"
            print(f"  {label}, {where}: {rms:.2f} m, {nees:.1f} (none estimated: {rms_before:.2f} m, "
                  f"{nees_before:.1f}; fixes alone {fixes_rms:.1f} m)")  # fmt: skip
            if errors == WORSE["as it is"] and (nees > 4.0 or (not outage and rms > 0.7)):
                missed.append(f"at most 0.7 m and NEES at most 4 ({where})")
    print(f"claims: {missed or 'all met'}")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
