"""One hour of two wheels at 100 Hz with GNSS at 5 Hz, from the MCAP file to track.csv, with the real command.

    python tests/bench/bench_hour.py [SECONDS]

Five runs of `hubodo fuse` on the same log, including the start of the interpreter. Beside each runs the plain
GTSAM graph of bench_fuse.py with a pose per odometry sample, which is only built and solved, without reading,
filtering and sigmas.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from bench_fuse import hour, peer
from speedups import record_speedup

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators import gnss_drives, wheel_drives
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from vehicles import vehicle_toml

SEED, SIGMA, LIMIT, RUNS = 71, 5.0, 6.0, 5
BEGIN = 1.0
"""s of the log at which the drive begins: a node's clock may be ahead of it."""


def recording(seconds):
    rng = np.random.default_rng(SEED)
    drive = wheel_drives.drive(wheel_drives.loop(rng, length=1.3 * seconds), rng, rate_hz=100.0)
    names = ("t", "gx", "gy", "gz", "ax", "ay", "az")
    nodes = {
        name: Table(dict(zip(names, (node.t + BEGIN, *node.gyro.T, *node.accel.T), strict=True)))
        for name, node in drive.nodes.items()
    }
    t = np.arange(drive.t[0], drive.t[-1], 0.2)
    east, north = (
        np.interp(t, drive.t, coordinate) + rng.normal(0, SIGMA, len(t)) for coordinate in (drive.x, drive.y)
    )
    latitude, longitude = gnss_drives.geodetic(east, north, 47.0, 8.0)[:2]
    gnss = {
        "t": t + BEGIN,
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "altitude": 0 * t,
        "sigma": SIGMA + 0 * t,
    }
    truth = {"t": drive.t + BEGIN, "x": drive.x, "y": drive.y, "heading": drive.heading}
    truth = {name: values[::10] for name, values in truth.items()}
    return Recording(nodes, gnss=Table(gnss), truth=Table(truth)), drive


def of_children():
    """Return the processor time of all processes that have ended, s."""
    used = os.times()
    return used.children_user + used.children_system


def main():
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 3600.0
    with tempfile.TemporaryDirectory() as folder:
        recorded, drive = recording(seconds)
        log, vehicle, out = (str(Path(folder) / name) for name in ("hour.mcap", "vehicle.toml", "out"))
        write_recording(recorded, Path(log))
        Path(vehicle).write_text(vehicle_toml(drive.radius, drive.track))
        rows = sum(len(node) for node in recorded.nodes.values())
        del recorded
        walls, busy, theirs = [], [], []
        odometry = hour(seconds, 100.0)
        words = [
            sys.executable,
            "-m",
            "hubodo.cli",
            "fuse",
            log,
            "--vehicle",
            vehicle,
            "-o",
            out,
            "--force",
            "--json",
        ]
        for _ in range(RUNS):
            started, before = time.perf_counter(), of_children()
            done = subprocess.run(words, capture_output=True, text=True, check=True)
            walls.append(time.perf_counter() - started)
            busy.append(of_children() - before)
            theirs.append(peer(odometry)[2])
        result = json.loads(done.stdout)
    wall = statistics.median(walls)
    print(f"{seconds:g} s, {rows} samples of two nodes, {result['graph']['fixes']} fixes (seed {SEED}): "
          f"log to track.csv in {wall:.2f} s, median of {RUNS} ({min(walls):.2f} to {max(walls):.2f}); "
          f"aim {LIMIT:g} s for an hour")  # fmt: skip
    print(f"  {statistics.median(busy):.2f} s of processor time ({min(busy):.2f} to {max(busy):.2f})")
    times = [other / own for own, other in zip(busy, theirs, strict=True)]
    record_speedup(f"{seconds:g} s from the log to track.csv: GTSAM building and solving", times)
    share = 1 / statistics.median(times)
    print(f"  {share:.2f} of the processor that GTSAM takes to build and solve a pose per sample")
    print(f"  rms error {result['truth']['rms_error']:.2f} m over {drive.length:.0f} m")
    return 0


if __name__ == "__main__":
    sys.exit(main())
