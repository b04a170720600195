"""Processor time of live odometry per sample, as run by `record`, beside a Kalman filter of filterpy.

    python tests/bench/bench_live.py [--seconds 120] [--seed 3]

Two nodes, blocks of eight samples as a node sends them, a pose published for every sample. The peer is the
obvious first program with a library: six states (position, heading, speed, yaw rate, gyro bias), predicted
and updated for every pair of samples; it estimates neither wheel angle nor calibration.
"""

import os
import statistics
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from speedups import record_speedup

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators import wheel_drives
from hubodo.ingest.live.odometer import Odometer
from hubodo.log.records import ImuBlock
from hubodo.vehicle import NodeMount, Vehicle
from script_arguments import script_parser

RATES_HZ = (104.0, 208.0, 416.0)
BLOCK = 8
LIMIT_US, LONGEST_MS = 30.0, 2.0


def blocks(drive):
    """Return blocks of both nodes in order of their ends."""
    blocks = []
    for name, node in drive.nodes.items():
        t_ns = np.round(node.t * 1e9).astype(np.int64)
        for first in range(0, len(t_ns) - BLOCK + 1, BLOCK):
            part = slice(first, first + BLOCK)
            blocks.append(ImuBlock(name, node.gyro[part], node.accel[part], 25.0, 0, t_ns=t_ns[part]))
    return sorted(blocks, key=lambda block: int(block.t_ns[-1]))


def ours(drive):
    """Return the time per sample, µs, and the longest call, ms."""
    mounts = {side: NodeMount(side, "left") for side in ("left", "right")}
    odometer = Odometer(Vehicle(drive.radius, drive.track, mounts), 0)
    calls, samples = [], 0
    for block in blocks(drive):
        began = time.process_time()
        odometer.handle(block)
        calls.append(time.process_time() - began)
        samples += len(block.t_ns)
    return sum(calls) / samples * 1e6, max(calls) * 1e3


def peer(drive):
    """Return the time per sample of the two nodes, µs."""
    left, right = (drive.nodes[name] for name in ("left", "right"))
    count, dt = min(len(left.t), len(right.t)), float(np.median(np.diff(left.t)))
    theirs = ExtendedKalmanFilter(6, 2)
    theirs.Q, theirs.R, theirs.P = 1e-4 * np.eye(6), 1e-3 * np.eye(2), np.eye(6)
    half, radius = 0.5 * drive.track, drive.radius
    rows = np.array([[0, 0, 0, 1, -half, 0], [0, 0, 0, 1, half, 0]], float)
    spins = np.column_stack([left.gyro[:count, 2], right.gyro[:count, 2]])
    began = time.process_time()
    for spin in spins:
        x, y, heading, speed, rate, bias = theirs.x[:, 0]
        cos, sin = np.cos(heading), np.sin(heading)
        theirs.F = np.eye(6)
        theirs.F[0, 2:4] = -speed * sin * dt, cos * dt
        theirs.F[1, 2:4] = speed * cos * dt, sin * dt
        theirs.F[2, 4] = dt
        x, y, heading = x + speed * cos * dt, y + speed * sin * dt, heading + rate * dt
        theirs.x = np.array([[x, y, heading, speed, rate, bias]]).T
        theirs.P = theirs.F @ theirs.P @ theirs.F.T + theirs.Q
        theirs.update((spin * radius)[:, None], lambda x: rows, lambda x: rows @ x)
    return (time.process_time() - began) / (2 * count) * 1e6


def main():
    parser = script_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    print(f"live odometry of two wheels, processor time, medians of {args.rounds} rounds, seed {args.seed}")
    print(f"  {'rate':>8} {'filterpy':>12} {'ours':>12} {'ratio':>7} {'longest call':>13} {'of a core':>10}")
    missed = False
    for rate in RATES_HZ:
        rng = np.random.default_rng(args.seed)
        plan = wheel_drives.loop(rng, length=1.2 * args.seconds)
        drive = wheel_drives.drive(plan, rng, rate_hz=rate)
        rounds = [(*ours(drive), peer(drive)) for _ in range(args.rounds)]
        record_speedup(
            f"live odometry at {rate:.0f} Hz: filterpy", [other / mine for mine, _, other in rounds]
        )
        cost, longest, theirs = (statistics.median(column) for column in zip(*rounds, strict=True))
        share = cost * 1e-6 * 2 * rate
        cells = f"{theirs:9.1f} µs {cost:9.1f} µs {cost / theirs:7.2f} {longest:10.2f} ms {share:9.1%}"
        print(f"  {rate:5.0f} Hz {cells}")
        missed |= cost > LIMIT_US or longest > LONGEST_MS
    print(f"  aims: {LIMIT_US:.0f} µs a sample, {LONGEST_MS:.0f} ms a call: {'missed' if missed else 'met'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
