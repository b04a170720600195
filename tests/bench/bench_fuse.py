"""One hour of odometry with GNSS at 5 Hz: our graph beside a plain GTSAM graph with a pose per sample.

    python tests/bench/bench_fuse.py [SECONDS]

The peer is the obvious first program: BetweenFactorPose2 from sample to sample (100 Hz), noise of a tenth of
an increment, PoseTranslationPrior2D for each fix at the nearest sample, Gauss-Newton with sequential Cholesky
(the default solver overflows the stack on such a chain), started from the true first pose. It estimates
neither constants nor sigmas; ours estimates both, and its own initial heading. Also measured is the time of a
live fix in a window of one minute, beside the 200 ms until the next one.
"""

import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from speedups import record_speedup

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators import gnss_drives
from hubodo.fuse.graph.batch import Fixes, fuse_graph
from hubodo.fuse.graph.live import LiveGraph, LiveLimits
from hubodo.fuse.projection import make_local_frame
from hubodo.fuse.track import Track

SEED, SIGMA = 54, 5.0
LIMIT = 1.5
LIVE, LIVE_LIMIT = 150.0, 0.02
"""s of the drive, and s of processor time that a fix may cost: a tenth of the time until the next."""


def hour(seconds, rate_hz):
    rng = np.random.default_rng(SEED)
    laps = max(1, int(seconds * 1.3 / 250.0))
    return gnss_drives.drive(rng, gnss_drives.loop(rng, laps=laps), rate_hz=rate_hz, sigma=SIGMA)


def timed(work):
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, time.perf_counter() - wall, time.process_time() - cpu


def ours(drive):
    path = Track(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading)
    fixes = Fixes(drive.fix_t, drive.fix_latitude_deg, drive.fix_longitude_deg)
    result, wall, cpu = timed(lambda: fuse_graph(path, fixes))
    zero = np.zeros(1)
    x, y = result.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
    tx, ty, _ = drive.truth(result.track.t)
    error = np.sqrt(np.mean((result.track.x - x - tx) ** 2 + (result.track.y - y - ty) ** 2))
    return wall, cpu, error, len(result.pose_t)


def peer(drive):
    import gtsam

    frame = make_local_frame(*drive.origin)
    fx, fy = frame.to_local(drive.fix_latitude_deg, drive.fix_longitude_deg)
    step = np.diff(drive.odo_x + 1j * drive.odo_y) * np.exp(-1j * drive.odo_heading[:-1])
    turn = np.diff(drive.odo_heading)
    nearest = np.clip(np.rint((drive.fix_t - drive.odo_t[0]) / np.median(np.diff(drive.odo_t))), 0, len(turn))
    x0, y0, h0 = drive.truth(drive.odo_t[0])
    place = (drive.odo_x + 1j * drive.odo_y) * np.exp(1j * h0) + x0 + 1j * y0

    def build():
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        # A tenth of the usual increment (Shah et al. section IV); a single object is fastest to build.
        own = 0.1 * np.array([np.median(np.abs(step)), np.median(np.abs(step)), np.median(np.abs(turn))])
        noise = gtsam.noiseModel.Diagonal.Sigmas(own)
        fix = gtsam.noiseModel.Isotropic.Sigma(2, SIGMA)
        for k, (move, angle) in enumerate(zip(step.tolist(), turn.tolist(), strict=True)):
            graph.add(gtsam.BetweenFactorPose2(k, k + 1, gtsam.Pose2(move.real, move.imag, angle), noise))
        for k, x, y in zip(nearest.astype(int).tolist(), fx.tolist(), fy.tolist(), strict=True):
            graph.add(gtsam.PoseTranslationPrior2D(k, np.array([x, y]), fix))
        headings = (drive.odo_heading + h0).tolist()
        for k, (at, heading) in enumerate(zip(place.tolist(), headings, strict=True)):
            values.insert(k, gtsam.Pose2(at.real, at.imag, heading))
        return graph, values

    def optimise():
        parameters = gtsam.GaussNewtonParams()
        parameters.setLinearSolverType("SEQUENTIAL_CHOLESKY")
        return gtsam.GaussNewtonOptimizer(graph, values, parameters).optimize()

    (graph, values), built, built_cpu = timed(build)
    result, solved, solved_cpu = timed(optimise)
    poses = np.array([result.atPose2(k).translation() for k in range(len(place))])
    error = np.sqrt(np.mean((poses[:, 0] - np.interp(drive.odo_t, drive.t, drive.x)) ** 2
                            + (poses[:, 1] - np.interp(drive.odo_t, drive.t, drive.y)) ** 2))  # fmt: skip
    return built, solved, built_cpu + solved_cpu, error, len(place)


def live(drive):
    """Return the processor time of a fix with a full window, and of the longest step, s."""
    graph, place, steps, begun = LiveGraph(), 0, [], 0.0
    for t, *pose in zip(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading, strict=True):
        if t > LIVE:
            break
        start = time.process_time()
        graph.add_odometry(t, *pose)
        while drive.fix_t[place] <= t:
            graph.add_fix(
                drive.fix_t[place], drive.fix_latitude_deg[place], drive.fix_longitude_deg[place], SIGMA
            )
            place += 1
        steps.append((t, time.process_time() - start))
        if graph.state() is not None:
            begun = begun or t
    full = sum(used for t, used in steps if t > begun + LiveLimits().lag)
    count = np.count_nonzero((drive.fix_t > begun + LiveLimits().lag) & (drive.fix_t < LIVE))
    return full / count, max(used for t, used in steps if t <= begun)


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    seconds = float(arguments[0]) if arguments else 3600.0
    print(f"{seconds:g} s of driving, fixes of {SIGMA:g} m at 5 Hz (seed {SEED})")
    times = {}
    for rate_hz in (10.0, 100.0):
        drive = hour(seconds, rate_hz)
        wall, cpu, error, states = ours(drive)
        times[rate_hz] = cpu
        print(f"  ours, odometry at {rate_hz:g} Hz: {wall:.2f} s ({cpu:.2f} s CPU), {states} poses solved, "
              f"{len(drive.odo_t)} given back with sigmas, rms {error:.2f} m")  # fmt: skip
    built, solved, cpu, error, states = peer(drive)
    print(f"  GTSAM, a pose per sample: {built:.2f} s to build, {solved:.2f} s to solve ({cpu:.2f} s CPU), "
          f"{states} poses, rms {error:.2f} m")  # fmt: skip
    print(f"  CPU ratio at 100 Hz: {times[100.0] / cpu:.3f}; ours at 10 Hz at most {LIMIT} s CPU")
    record_speedup(f"{seconds:g} s of odometry and fixes: GTSAM", [cpu / times[100.0]])
    step, start = live(hour(LIVE, 10.0))
    print(f"  live, {LiveLimits().lag:g} s of poses at 5 Hz: {1e3 * step:.1f} ms CPU a fix, at most "
          f"{1e3 * LIVE_LIMIT:g}; a start {1e3 * start:.0f} ms")  # fmt: skip
    return int(times[10.0] > LIMIT * seconds / 3600.0 + 0.5 or times[100.0] > cpu or step > LIVE_LIMIT)


if __name__ == "__main__":
    sys.exit(main())
