"""Standstills that `hubodo heading` finds by itself in five minutes of steady turns, each 30 s long."""

import argparse
import contextlib
import io
import json
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.steady_turns import WORLDS, steady_turns
from hubodo.cli import main as hubodo
from hubodo.errors import CalibrationError
from hubodo.log.csv_folder import write_folder
from hubodo.recording import Recording, Table
from hubodo.sensors.imu.standstills import find_standstills


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = parser.parse_args().seeds
    start = time.process_time()
    print(f"vertical gyro, 0.2 deg/s of noise at 20 Hz, scale off by 1 %, seeds 0 to {seeds - 1}; degrees")
    print("right: within 3 sigma. doubt: wrong, and the output says that nothing confirms the standstill.")
    print("plain: mean of the segments near the median rate. bound: white noise, true standstills known.")
    print("each row draws its own scale and noise, so that the rows are independent.")
    counts = [print_row(number, name, world, seeds) for number, (name, world) in enumerate(WORLDS.items())]
    inside, answered = np.sum(counts, axis=0)
    low, high = interval(inside, answered)
    print(f"all records: within 1.96 sigma {inside}/{answered} [{low:.2f}, {high:.2f}]")
    print(f"processor {time.process_time() - start:.0f} s")


def print_row(number, name, world, seeds):
    """Print the row of a kind of record; return how many answers are within 1.96 sigma, and of how many."""
    z, error, sigma, bound, plain, silent, doubt, refused = [], [], [], [], [], 0, 0, 0
    for seed in range(seeds):
        t, gyro, accel, heading = steady_turns([seed, number], scale_sigma=0.01, **world)
        plain.append(plain_error(t, gyro, accel, heading))
        result = run(t, gyro, accel)
        if result is None:
            refused += 1
            continue
        off = result["turned_deg"]["heading"] - np.degrees(heading[-1])
        if abs(off) > 3 * result["sigma_deg"]:
            noted = any("only its small rate" in note for note in result["notes"])
            silent, doubt = silent + (not noted), doubt + noted
            continue
        error.append(off)
        sigma.append(result["sigma_deg"])
        z.append(off / result["sigma_deg"])
        standing = np.diff(heading, append=heading[-1]) == 0.0
        seconds = np.count_nonzero(standing) / 20.0
        white = np.hypot(0.045 * np.sqrt(t[-1]), 0.045 / np.sqrt(max(seconds, 0.1)) * t[-1])
        bound.append(np.hypot(white, 0.01 * np.degrees(heading[-1])))
    answered = len(z) + silent + doubt
    inside = int(np.count_nonzero(np.abs(z) < 1.96))
    low, high = interval(inside, answered)
    wrong = sum(not np.isfinite(off) or abs(off) > 30.0 for off in plain)
    print(
        f"{name:20s} right {len(z):2d} silently wrong {silent} doubt {doubt} refused {refused:2d}; "
        f"error {rms(error):5.2f} sigma {rms(sigma):5.2f} bound {rms(bound):5.2f}; within 1.96 sigma "
        f"{inside}/{answered} [{low:.2f}, {high:.2f}]; plain beyond 30 deg or refused {wrong}",
        flush=True,
    )
    return inside, answered


def interval(inside, answered):
    """Return the 95 % interval of a share (Jeffreys)."""
    if not answered:
        return 0.0, 1.0
    return tuple(beta.ppf([0.025, 0.975], inside + 0.5, answered - inside + 0.5).tolist())


def run(t, gyro, accel):
    columns = dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True))
    with tempfile.TemporaryDirectory() as folder:
        write_folder(Recording({"imu": Table(columns)}), Path(folder) / "log")
        output = io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO()):
            status = hubodo(["heading", str(Path(folder) / "log"), "--json"])
    return json.loads(output.getvalue()) if status == 0 else None


def plain_error(t, gyro, accel, heading):
    """Return the error at the end with the bias from all segments that are near the median rate, degrees."""
    try:
        quiet = find_standstills(t, gyro, accel)
    except CalibrationError:
        return float("nan")
    bias = np.average(quiet.gyro[:, 2], weights=quiet.end - quiet.start)
    return float(np.degrees(np.trapezoid(gyro[:, 2] - bias, t) - heading[-1]))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


if __name__ == "__main__":
    main()
