"""Wheels that slip, lift, steer, or are not one axle: errors, detections and false alarms.

    python tests/accuracy/slip.py [--drives 16] [--first-seed 100]

Loops of 120 m on a hilly, rough road with coloured noise from tests/generators, which shares no code with the
filter. Nothing is calibrated beforehand. In drives where nothing happens each detection is a false alarm.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

import wanted
from accuracy import car
from generators import gnss_drives, slip_drives, wheel_drives
from generators.wheel_drives import Plan, WheelDrive
from hubodo.fuse.fusion import fuse_recording
from hubodo.fuse.wheel.config import WheelConfig, WheelNode, wheel_config
from hubodo.fuse.wheel.track import WheelRun, run_wheel_filter
from hubodo.log.csv_folder import read_folder
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from script_arguments import script_parser
from wheel_runs import BOTH, config, end_error, nees, pose_error, tables

ERRORS = replace(wheel_drives.Errors(), flicker=1e-4, accel_flicker=3e-3)
"""The usual errors, with bias instability: 20 deg/h of the gyros, 0.3 mg of the accelerometers."""

_TIME_TOLERANCE = 0.5
"""Tolerance of start and end of a detected slip, s."""

Change = Callable[[Plan, tuple[str, ...], float], Plan]


@dataclass(frozen=True)
class Case:
    """An event of a drive: its wheels (0: one of them, in turn), duration (s), and kind."""

    wheels: int
    duration: float
    change: Change


def _lift(ends_at: float, lasts: float) -> Case:
    return Case(
        1, 6.0, lambda plan, names, start: slip_drives.lifted(plan, names[0], start, 6.0, ends_at, lasts)
    )


def _spin(wheels: int, duration: float, times: float) -> Case:
    return Case(
        wheels, duration, lambda plan, names, start: slip_drives.spinning(plan, names, start, duration, times)
    )


CASES = {
    "one wheel, nothing happens": Case(1, 6.0, lambda plan, names, start: plan),
    "one wheel, lifted 6 s, stopped by something": _lift(0.0, 0.3),
    "one wheel, lifted 6 s, runs out in 1 s": _lift(0.0, 1.0),
    "one wheel, lifted 6 s, spun up to double": _lift(2.0, 1.0),
    "one wheel, lifted 6 s, runs out in 3 s": _lift(0.0, 3.0),
    "one wheel, lifted 6 s, half its speed in 6 s": _lift(0.5, 6.0),
    "one wheel, 6 s of double spin": _spin(1, 6.0, 2.0),
    "two wheels, nothing happens": Case(2, 1.5, lambda plan, names, start: plan),
    "two wheels, 1.5 s of double spin": _spin(2, 1.5, 2.0),
    "two wheels, locked for 1.5 s": _spin(2, 1.5, 0.0),
}
LIFTED = "one wheel, lifted 6 s, runs out in 1 s"


@dataclass(frozen=True)
class Outcome:
    """Final error in % of the path, NEES of the final pose, detected wheels, and number of false alarms."""

    error: float
    nees: float
    detected: int
    false: int


def make_drive(case: Case, seed: int) -> tuple[WheelDrive, tuple[str, ...], float]:
    """Return a drive, the nodes that record it, and the time of its event, s."""
    rng = np.random.default_rng(seed)
    plan = slip_drives.driven_loop(rng)
    names = BOTH if case.wheels == 2 else (BOTH[seed % 2],)
    start = slip_drives.moving_time(plan, rng, 8.0)
    return wheel_drives.drive(case.change(plan, names, start), rng, ERRORS), names, start


def outcome(case: Case, seed: int) -> Outcome:
    """Return the result of one drive."""
    drive, names, start = make_drive(case, seed)
    result = run_wheel_filter(config(drive, names), tables(drive))
    hits = alarms = 0
    for slips in result.report.slips.values():
        inside = [
            slip.start < start + case.duration + _TIME_TOLERANCE and slip.end > start - _TIME_TOLERANCE
            for slip in slips
        ]
        hits += any(inside)
        alarms += inside.count(False)
    return Outcome(100.0 * end_error(drive, result) / drive.length, nees(drive, result), hits, alarms)


def table_row(name: str, case: Case, outcomes: Sequence[Outcome]) -> str:
    """Return a row of the table."""
    error = np.percentile([result.error for result in outcomes], [50, 90])
    mean_nees = np.mean([result.nees for result in outcomes])
    wheels = case.wheels * len(outcomes)
    hits, alarms = sum(result.detected for result in outcomes), sum(result.false for result in outcomes)
    if "nothing" in name:
        hits, alarms = 0, hits + alarms
    detections = f"detected {hits:3d} of {0 if 'nothing' in name else wheels:3d}, false alarms {alarms}"
    return f"{name:46s}{error[0]:7.2f}{error[1]:7.2f} %  NEES {mean_nees:7.2f} of 3  {detections}"


def error_in_slip(case: Case, seed: int, lag: float) -> tuple[float, float]:
    """Return error, m, and NEES in the middle of an event, of a track smoothed with `lag` s."""
    drive, names, start = make_drive(case, seed)
    track = run_wheel_filter(config(drive, names), tables(drive), lag).track
    error, covariance = pose_error(drive, track, int(np.searchsorted(track.t, start + 0.5 * case.duration)))
    return float(np.hypot(*error[:2])), float(error @ np.linalg.solve(covariance, error))


def fuse_with_fixes(case: Case, seed: int, sigma: float = 1.0) -> tuple[float, float]:
    """Return largest error, m, and mean NEES of x and y during an event, with fixes at 2 Hz."""
    drive, names, start = make_drive(case, seed)
    rng = np.random.default_rng([seed, 71])
    t = np.arange(drive.t[0], drive.t[-1], 0.5)
    east, north = (
        np.interp(t, drive.t, distance) + rng.normal(0.0, sigma, len(t)) for distance in (drive.x, drive.y)
    )
    latitude_deg, longitude_deg = gnss_drives.geodetic(east, north, 47.0, 8.0)[:2]
    gnss = {"t": t, "latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "sigma": sigma + 0 * t}
    mounts = {name: NodeMount(name, "left") for name in names}
    vehicle = Vehicle(drive.radius, drive.track, mounts)
    nodes = {name: table for name, table in tables(drive).items() if name in names}
    track = fuse_recording(Recording(nodes, gnss=Table(gnss)), vehicle, log=f"seed {seed}").track
    distance = [
        np.interp(track.t, drive.t, one) - np.interp(track.t[0], drive.t, one) for one in (drive.x, drive.y)
    ]
    error = np.array([track.x, track.y]) - distance
    inside = (track.t > start) & (track.t < start + case.duration)
    scaled = error[:, inside] / [track.sigma_x[inside], track.sigma_y[inside]]
    return float(np.hypot(*error).max()), float(np.mean(np.sum(scaled**2, axis=0)))


def steered_outcome(seed: int, side: str) -> tuple[Outcome, bool]:
    """Return the outcome of two nodes declared as an axle of which one is steered, and whether the fixed one
    is used.

    `detected` is 1 if a warning says that the two wheels are not an axle.
    """
    drive = slip_drives.steered(np.random.default_rng(seed), ERRORS, side)
    run = run_wheel_filter(config(drive), tables(drive))
    is_warned = any(
        "steers" in table_row or "not those of an axle" in table_row for table_row in run.report.warnings
    )
    fixed_wheel_used = [wheel.name for wheel in run.filter.core.wheels] == [
        BOTH[1] if side == BOTH[0] else BOTH[0]
    ]
    error = 100.0 * end_error(drive, run) / drive.length
    return Outcome(error, nees(drive, run), int(is_warned), 0), fixed_wheel_used


def swapped_sides_outcome(seed: int) -> Outcome:
    """Return the outcome of a drive whose nodes have swapped sides; `detected` is 1 if a warning says so."""
    drive, _, _ = make_drive(CASES["two wheels, nothing happens"], seed)
    recorded = tables(drive)
    result = run_wheel_filter(config(drive), {"left": recorded["right"], "right": recorded["left"]})
    is_warned = any("exchanged" in table_row for table_row in result.report.warnings)
    return Outcome(100.0 * end_error(drive, result) / drive.length, nees(drive, result), int(is_warned), 0)


def careless_outcome(seed: int) -> Outcome:
    """Return the outcome for radii and a track width with errors of 2 % and 3 % (1σ).

    `false` is 1 if the wheels are rejected as an axle.
    """
    rng = np.random.default_rng(seed)
    errors = replace(wheel_drives.Errors(), radius=0.02, track=0.03)
    drive = wheel_drives.drive(wheel_drives.loop(rng, 130.0, 6.0), rng, errors)
    result = run_wheel_filter(config(drive), tables(drive))
    is_single_wheel = len(result.filter.core.wheels) == 1
    return Outcome(
        100.0 * end_error(drive, result) / drive.length, nees(drive, result), 0, int(is_single_wheel)
    )


def pair_errors(seeds: Sequence[int], tape_sigma: float) -> dict[str, np.ndarray]:
    """Return the final errors in % of the path of each wheel and of both.

    tape_sigma: 1σ of the track width, relative.
    """
    errors: dict[str, list[float]] = {}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        drive = wheel_drives.drive(wheel_drives.loop(rng, 150.0, 6.0), rng, replace(ERRORS, track=tape_sigma))
        for names in (("left",), ("right",), BOTH):
            result = run_wheel_filter(config(drive, names), tables(drive))
            errors.setdefault(" and ".join(names), []).append(100.0 * end_error(drive, result) / drive.length)
    return {name: np.array(result) for name, result in errors.items()}


def count_real_alarms(node_sets: Sequence[tuple[str, ...]] = car.SETS) -> dict[str, int]:
    """Return the number of slips detected on each real drive; none of the drives has one."""
    runs: dict[str, WheelRun] = {}
    for name, log in car.drives().items():
        for names in node_sets:
            if set(names) <= set(log.nodes):
                runs[f"car {name}, {' and '.join(names)}"] = run_wheel_filter(
                    wheel_config(car.CAR, list(names)), log.nodes
                )
    chair = read_folder(wanted.recording("wheelchair"))
    for names in node_sets:
        nodes = {name: WheelNode(name, "left") for name in names}  # type: ignore[arg-type]
        runs[f"wheelchair, {' and '.join(names)}"] = run_wheel_filter(
            WheelConfig(0.31, 0.92, nodes), chair.nodes
        )
    return {name: sum(map(len, result.report.slips.values())) for name, result in runs.items()}


def main() -> int:
    """Print the table."""
    parser = script_parser(__doc__, drives=16, first_seed=100)
    args = parser.parse_args()
    seeds = range(args.first_seed, args.first_seed + args.drives)
    print(f"loops of 120 m, seeds {seeds[0]} to {seeds[-1]}; error at the end in % of the path: median, 90 %")
    for name, case in CASES.items():
        print("  " + table_row(name, case, [outcome(case, seed) for seed in seeds]), flush=True)
    print("  in the middle of the slip, by smoothing lag: median error, median NEES of 3")
    for name, case in CASES.items():
        if "lifted" in name:
            errors_by_lag = {
                lag: [error_in_slip(case, seed, lag) for seed in seeds] for lag in (0.0, 10.0, np.inf)
            }
            text = "".join(
                "   {:4g} s {:5.2f} m {:8.2f}".format(lag, *np.median(errors, axis=0))
                for lag, errors in errors_by_lag.items()
            )
            print(f"    {name:44s}{text}", flush=True)
    print("  with fixes of 1 m at 2 Hz: largest error, median and 90 %; mean NEES of 2 during the event")
    for name, case in CASES.items():
        if case.wheels == 1:
            error, nees_values = np.array([fuse_with_fixes(case, seed) for seed in seeds]).T
            median, upper = np.percentile(error, [50, 90])
            print(f"    {name:44s}{median:6.2f}{upper:6.2f} m  NEES {np.mean(nees_values):6.2f}", flush=True)
    for side in BOTH:
        result = [steered_outcome(seed, side) for seed in seeds]
        n_fixed_used = sum(fixed_used for _, fixed_used in result)
        name = f"two wheels, the {side} one steered"
        text = table_row(
            name, Case(1, 0.0, CASES["two wheels, nothing happens"].change), [each for each, _ in result]
        )
        print(f"  {text}, the fixed one used in {n_fixed_used}", flush=True)
    text = table_row("two wheels, exchanged", CASES[LIFTED], [swapped_sides_outcome(seed) for seed in seeds])
    print("  " + text, flush=True)
    careless = [careless_outcome(seed) for seed in seeds]
    print(
        "  " + table_row("two wheels, careless tape (nothing happens)", CASES[LIFTED], careless), flush=True
    )
    print("  both wheels and each of them alone, loops of 150 m: median, 90 %, rms")
    for tape in (0.005, 0.03):
        for name, errors in pair_errors(seeds, tape).items():
            median, upper = np.percentile(errors, [50, 90])
            rms = np.sqrt(np.mean(errors**2))
            print(
                f"    track measured to {tape:5.1%}, {name:15s}{median:6.2f}{upper:6.2f}{rms:6.2f} %",
                flush=True,
            )
    for name, alarms in count_real_alarms().items():
        print(f"  {name}: {alarms} false alarms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
