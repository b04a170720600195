"""Time of the papers' filters beside filterpy in the same run: live updates, and batches per sample.

python tests/bench/bench_filters.py [SAMPLES]

Peers: filterpy's KalmanFilter with the two states of eq. 4-8; the same with fading memory, which is eq.
13-14; its ExtendedKalmanFilter with H and R of eq. 2-3. A live update takes plain Python floats.
"""

import math
import os
import statistics
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from speedups import record_speedup

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hubodo.sensors.filters.pseudo_measurement import PseudoMeasurementFilter
from hubodo.sensors.filters.rate_bias_kalman import RateBiasKalman, steady_state_gain
from hubodo.sensors.filters.recursive_least_squares import RecursiveLeastSquares

ROUNDS = 9
AIMED = {"Kalman": 200, "RLS": 40}
BATCH_NS = 50.0
SIGMA = 1e-3
FACTOR = 0.98


def peer_kalman():
    theirs = KalmanFilter(2, 1)
    theirs.H, theirs.R = np.array([[1.0, 1.0]]), np.array([[SIGMA**2]])
    theirs.Q = np.diag([1e-4, 1e-12])

    def update(z):
        theirs.predict()
        theirs.update(z)

    return update


def peer_rls():
    theirs = KalmanFilter(2, 1)
    theirs.alpha, theirs.Q, theirs.P = 1 / math.sqrt(FACTOR), np.zeros((2, 2)), 1e6 * np.eye(2)
    row, n, estimate = np.zeros((1, 2)), 0, 0.0

    def update(z):
        nonlocal n, estimate
        n += 1
        row[0, 0], row[0, 1] = n, estimate - z
        theirs.predict()
        theirs.update(z, H=row)
        estimate = row[0, 0] * theirs.x[0, 0] + row[0, 1] * theirs.x[1, 0]

    return update


def peer_pseudo():
    theirs = ExtendedKalmanFilter(3, 1)
    theirs.P, noise = 2.5e-3 * np.eye(3), SIGMA**2 * np.eye(3)
    constant = 2 * np.trace(noise @ noise)

    def update(gyro):
        d = gyro - theirs.x[:, 0]
        theirs.update(
            np.array([[gyro @ gyro - 3 * SIGMA**2]]),
            lambda x: 2 * (gyro - x[:, 0])[None, :],
            lambda x: np.array([[2 * gyro @ x[:, 0] - x[:, 0] @ x[:, 0]]]),
            R=4 * d @ noise @ d + constant,
        )

    return update


def live_ns(update, values):
    began = time.process_time()
    for value in values:
        update(value)
    return (time.process_time() - began) / len(values) * 1e9


def batch_ns(run, values):
    began = time.process_time()
    run(values)
    return (time.process_time() - began) / len(values) * 1e9


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    count = int(arguments[0]) if arguments else 360_000
    rng = np.random.default_rng(0)
    z = 6.0 + np.sin(1e-3 * np.arange(count)) + rng.normal(0.0, SIGMA, count)
    still = rng.normal(0.01, SIGMA, (count // 10, 3))
    gain = steady_state_gain(1e-2, 1e-6, SIGMA, 0.01)
    ours = {
        "Kalman": lambda: RateBiasKalman(gain, 0.01),
        "RLS": lambda: RecursiveLeastSquares(FACTOR),
        "pseudo-measurement": lambda: PseudoMeasurementFilter(SIGMA**2 * np.eye(3)),
    }
    peers = {"Kalman": peer_kalman, "RLS": peer_rls, "pseudo-measurement": peer_pseudo}
    print(f"filters, medians of {ROUNDS} rounds in turn; batches of {count} samples (seed 0)")
    print(f"  {'':20}{'filterpy':>10} {'ours, live':>11} {'ratio':>7} {'ours, batch':>12}")
    missed = []
    for name, make in ours.items():
        samples = still if name == "pseudo-measurement" else z
        short = samples[:2000].tolist()
        theirs_in = list(samples[:500]) if samples.ndim == 2 else short[:500]
        times = {"peer": [], "live": [], "batch": []}
        for _ in range(ROUNDS):
            times["peer"].append(live_ns(peers[name](), theirs_in))
            times["live"].append(live_ns(make().update, short))
            times["batch"].append(batch_ns(make().run, samples))
        each = [b / a for a, b in zip(times["live"], times["peer"], strict=True)]
        record_speedup(f"{name}, live: filterpy", each)
        peer, live, batch = (statistics.median(times[key]) for key in ("peer", "live", "batch"))
        print(f"  {name:20}{peer:7.0f} ns {live:8.0f} ns   1/{peer / live:<5.0f}{batch:9.1f} ns")
        if name in AIMED and live * AIMED[name] > peer:
            missed.append(f"{name} live")
        if batch > BATCH_NS and name == "Kalman":
            missed.append(f"{name} batch")
    aims = ", ".join(f"{name} live 1/{times} of filterpy" for name, times in AIMED.items())
    print(f"  aims: {aims}, Kalman batch {BATCH_NS:.0f} ns")
    print(f"  {'missed by ' + ', '.join(missed) if missed else 'met'}")
    print("  RLS and the pseudo-measurement are not linear: their batch is the live filter, sample by sample")
    return 0


if __name__ == "__main__":
    sys.exit(main())
