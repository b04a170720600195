"""A real car on the live map: error at the end of a GNSS outage of 60 s, beside its lower bound.

    python tests/accuracy/car_outage.py [--seeds 10] [--first-seed 0]

Fixes of 1.5 m (1σ) at 1 Hz: the RTK reference with white noise. The outage ends with the drive or up to 8 s
before; the state of the live graph at its end is scored, with the heading of the start known to 0.5° and
unknown. Bound: rms error that remains if the shape of the odometry is exact and only place, heading, wheel
radius, yaw scale and constant yaw rate have to be estimated from the same fixes and priors (Cramér-Rao).
NEES: squared error of x and y in units of sigma, 2 if consistent.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np
from numpy.typing import NDArray

from accuracy.car import CAR, SETS, drives, truth_of, with_nodes
from generators.gnss_drives import geodetic
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.constants import sigmas_for_wheel_filter
from hubodo.fuse.graph.live import LiveGraph
from hubodo.fuse.track import Track
from hubodo.fuse.wheel.config import RADIUS_SIGMAS, wheel_config
from hubodo.fuse.wheel.entries import GYRO_SCALE_ACROSS, YAW_RATE_FROM_GRAVITY
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.recording import Table
from script_arguments import script_parser

Array = NDArray[np.float64]

SIGMA, RATE_HZ, OUTAGE = 1.5, 1.0, 60.0
HEADING_SIGMA = np.radians(0.5)
ORIGIN = (47.37, 8.54)
CONSTANTS = sigmas_for_wheel_filter(
    RADIUS_SIGMAS[CAR.radius_from].total, [GYRO_SCALE_ACROSS.prior], YAW_RATE_FROM_GRAVITY.prior
)
"""Priors of the live map of `hubodo record`."""


def bound(path: Track, fix_t: Array, end: float, heading_sigma: float) -> float:
    """Return the rms position error at `end` of an efficient estimator, m."""
    step = np.diff(path.x + 1j * path.y)
    turned = np.append(0.0, np.diff(np.unwrap(path.heading)).cumsum())
    elapsed = path.t - path.t[0]

    def positions(parameters: Array, t: Array) -> Array:
        east, north, heading, radius, yaw_scale, yaw_rate = parameters
        turn = heading + yaw_scale * turned + yaw_rate * elapsed
        path_xy = np.append(0.0, np.cumsum(step * np.exp(0.5j * (turn[1:] + turn[:-1]))))
        xy = (1.0 + radius) * np.interp(t, path.t, path_xy) + complex(east, north)
        return np.concatenate([xy.real, xy.imag])

    def jacobian(t: Array) -> Array:
        columns = []
        for column in range(6):
            change = np.zeros(6)
            change[column] = 1e-6
            columns.append((positions(change, t) - positions(-change, t)) / 2e-6)
        return np.column_stack(columns)

    priors = np.array(
        [1e3, 1e3, heading_sigma, CONSTANTS.wheel_radius, CONSTANTS.yaw_scale, CONSTANTS.yaw_rate]
    )
    of_fixes, of_end = jacobian(fix_t) / SIGMA, jacobian(np.array([end]))
    covariance = np.linalg.inv(of_fixes.T @ of_fixes + np.diag(priors**-2.0))
    return float(np.sqrt(np.trace(of_end @ covariance @ of_end.T)))


def initial_heading(path: Track, truth: Table) -> float:
    """Return the heading of the first pose, rad, at which the track fits the reference."""
    inside = (path.t >= truth.t[0]) & (path.t <= truth.t[-1])
    track = (path.x + 1j * path.y)[inside]
    true = np.interp(path.t[inside], truth.t, truth["x"]) + 1j * np.interp(
        path.t[inside], truth.t, truth["y"]
    )
    rotation = np.angle(np.sum((true - true.mean()) * (track - track.mean()).conj()))
    return float(path.heading[0] + rotation)


def end_of_outage(path: Track, truth: Table, seed: int, knows_heading: bool) -> tuple[float, float, float]:
    """Return the error at the end of the outage, m, its NEES, and the bound, m."""
    rng = np.random.default_rng([seed, 34])
    end = min(path.t[-1], truth.t[-1]) - rng.uniform(0.0, 8.0)
    t = np.arange(max(path.t[0], truth.t[0]), end - OUTAGE, 1.0 / RATE_HZ)
    noise = SIGMA * rng.standard_normal((2, len(t)))
    east, north = (np.interp(t, truth.t, truth[name]) + n for name, n in zip("xy", noise, strict=True))
    fixes = list(zip(t.tolist(), *(v.tolist() for v in geodetic(east, north, *ORIGIN)), strict=True))
    graph = LiveGraph(GraphConfig(constants=CONSTANTS))
    if knows_heading:
        heading = initial_heading(path, truth) + HEADING_SIGMA * rng.standard_normal()
        graph.add_heading(float(t[0]), heading, HEADING_SIGMA)
    for pose in zip(path.t.tolist(), path.x.tolist(), path.y.tolist(), path.heading.tolist(), strict=True):
        if pose[0] > end:
            break
        graph.add_odometry(*pose)
        while fixes and fixes[0][0] <= pose[0]:
            graph.add_fix(*fixes.pop(0), SIGMA)
    state = graph.state()
    assert state is not None
    ox, oy = state.frame.to_local(*geodetic(0.0, 0.0, *ORIGIN))
    error = np.array(
        [
            state.x - float(ox) - np.interp(state.t, truth.t, truth["x"]),
            state.y - float(oy) - np.interp(state.t, truth.t, truth["y"]),
        ]
    )
    nees = float(error @ np.linalg.solve(state.covariance[:2, :2], error))
    return float(np.hypot(*error)), nees, bound(path, t, end, HEADING_SIGMA if knows_heading else 1e2)


def main() -> int:
    """Print a line for each drive and set of nodes; then all of them."""
    parser = script_parser(__doc__, seeds=10, first_seed=0)
    args = parser.parse_args()
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    print(f"seeds {seeds[0]} to {seeds[-1]}; m at the end of an outage of {OUTAGE:g} s")
    for knows_heading in (True, False):
        everything = []
        for name, log in drives().items():
            for names in SETS:
                if not set(names) <= set(log.nodes):
                    continue
                path = run_wheel_filter(wheel_config(with_nodes(names), list(names)), log.nodes).track
                truth = truth_of(log)
                if min(path.t[-1], truth.t[-1]) - max(path.t[0], truth.t[0]) < 1.5 * OUTAGE:
                    continue
                rows = np.array([end_of_outage(path, truth, seed, knows_heading) for seed in seeds])
                everything.append(rows)
                print(f"  {name} {'+'.join(names):<12}{_summary(rows)}", flush=True)
        label = "heading of the start known" if knows_heading else "heading unknown"
        print(f"{label}: {_summary(np.concatenate(everything))}")
    return 0


def _summary(rows: Array) -> str:
    errors, nees, bounds = rows.T
    return (
        f"median {np.median(errors):.2f}, rms {np.sqrt(np.mean(errors**2)):.2f}, largest {errors.max():.2f}; "
        f"NEES {nees.mean():.1f}; bound, rms {np.sqrt(np.mean(bounds**2)):.2f}"
    )


if __name__ == "__main__":
    sys.exit(main())
