"""Outages while driving and at standstill: error, consistency, and processor time of a sample.

python tests/accuracy/silence.py [--drives 6] [--seed 70] [--silences 1 3 20 60] [--pauses 0.5 600 7200]
"""

from __future__ import annotations

import gc
import sys
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from generators.outages import MEANWHILE, drive_with_outage, paused_drive  # noqa: E402
from generators.wheel_drives import WheelDrive  # noqa: E402
from hubodo.fuse.wheel.filter import WheelFilter  # noqa: E402
from hubodo.fuse.wheel.preintegration import WheelSample  # noqa: E402
from hubodo.fuse.wheel.track import run_wheel_filter  # noqa: E402
from script_arguments import script_parser  # noqa: E402
from wheel_runs import BOTH, config, pose_error, tables  # noqa: E402


def main() -> int:
    """Print a line for each outage and drive, with two wheels and one; then one for each pause."""
    parser = script_parser(__doc__, drives=6, seed=70)
    parser.add_argument("--silences", type=float, nargs="+", default=[1.0, 3.0, 20.0, 60.0])
    parser.add_argument("--pauses", type=float, nargs="+", default=[0.5, 3.0, 600.0, 7200.0, 259_200.0])
    args = parser.parse_args()
    seeds = range(args.seed, args.seed + args.drives)
    print(f"both nodes silent at 1.2 m/s, seeds {seeds[0]} to {seeds[-1]}; rms; NEES of 3:")
    for names in (BOTH, ("left",)):
        for seconds in args.silences:
            nees_pairs = [_run_outage(names, seconds, meanwhile, seeds) for meanwhile in MEANWHILE]
            nees_after, nees_end = np.mean(nees_pairs, axis=0)
            print(f"  {seconds:5.0f} s, all: NEES {nees_after:5.2f}, {nees_end:5.2f} at the end", flush=True)
    print(f"pauses at rest, seeds {seeds[0]} to {seeds[-1]}; heading and its sigma at the end, degrees:")
    for pause in args.pauses:
        _run_pause(pause, seeds)
    return 0


def _run_outage(names: tuple[str, ...], seconds: float, meanwhile: str, seeds: range) -> tuple[float, float]:
    rows = []
    for seed in seeds:
        drive, outage_end = drive_with_outage(seed, seconds, meanwhile)
        track = run_wheel_filter(config(drive, names), tables(drive)).track
        row = []
        for pose_index in (int(np.searchsorted(track.t, outage_end)), -1):
            error, covariance = pose_error(drive, track, pose_index)
            row += [np.sum(error[:2] ** 2), np.trace(covariance[:2, :2]), error[2] ** 2, covariance[2, 2]]
            row.append(float(error @ np.linalg.solve(covariance, error)))
        rows.append(row)
    mean = np.mean(rows, axis=0)
    error_xy, sigma, heading_error, heading_sigma = np.sqrt(mean[:4])
    print(
        f"  {seconds:5.0f} s, {'+'.join(names):10} {meanwhile:9}: {error_xy:6.2f} m, sigma {sigma:6.2f} m; "
        f"{np.degrees(heading_error):6.1f}°, sigma {np.degrees(heading_sigma):6.1f}°; NEES {mean[4]:5.2f}; "
        f"at the end {np.sqrt(mean[5]):6.2f} m, sigma {np.sqrt(mean[6]):6.2f} m, NEES {mean[9]:5.2f}",
        flush=True,
    )
    return mean[4], mean[9]


def _run_pause(seconds: float, seeds: range) -> None:
    error, heading_variances, position_sigmas, max_call_time, cpu_seconds = [], [], [], 0.0, 0.0
    for seed in seeds:
        drive, _, _ = paused_drive(seed, seconds)
        start = time.process_time()
        track = run_wheel_filter(config(drive), tables(drive)).track
        cpu_seconds = max(cpu_seconds, time.process_time() - start)
        covariance = track.covariance[-1]
        error.append(track.heading[-1] - drive.heading[-1])
        heading_variances.append(covariance[2, 2])
        position_sigmas.append(np.sqrt(np.trace(covariance[:2, :2])))
        max_call_time = max(max_call_time, _largest_call_time(drive)) if seed == seeds[0] else max_call_time
    print(
        f"  {seconds:8.1f} s: {np.degrees(np.sqrt(np.mean(np.square(error)))):5.2f}°, sigma "
        f"{np.degrees(np.sqrt(np.mean(heading_variances))):5.2f}°; position sigma "
        f"{np.mean(position_sigmas):7.1f} m; the log in {cpu_seconds:.2f} s of CPU, "
        f"live {1e3 * max_call_time:.2f} ms for a sample at most",
        flush=True,
    )


def _largest_call_time(drive: WheelDrive, times: int = 3) -> float:
    """Return the largest CPU time of a sample, s: the minimum over several runs for each sample."""
    samples = sorted(
        (
            WheelSample(name, t, tuple(gyro), tuple(accel))
            for name, node in drive.nodes.items()
            for t, gyro, accel in zip(node.t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True)
        ),
        key=lambda sample: sample.t,
    )
    costs = []
    gc.disable()
    for _ in range(times):
        output, spent = WheelFilter(config(drive)), []
        for sample in samples:
            start = time.process_time()
            output.handle(sample)
            spent.append(time.process_time() - start)
        costs.append(spent)
    gc.enable()
    return float(np.min(costs, axis=0).max())


if __name__ == "__main__":
    sys.exit(main())
