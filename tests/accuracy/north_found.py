"""North from the gyro alone, without table angles: errors and consistency of sigma by kind of record."""

import argparse
import os
import sys
import time
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.table_worlds import LATITUDE, WORLDS
from hubodo.sensors.north.axis_record import GyroAngleOptions, build_axis_record
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.north_estimate import find_north


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=40)
    seeds = parser.parse_args().seeds
    start = time.process_time()
    print(f"12 stops of about 20 s, gyro scale off by 1 %, {seeds} seeds from 0; degrees rms; NEES of 1")
    print("record    ours  sigma  of angles  NEES  inside 1, 2 sigma   nearest neighbours, angles rounded")
    for name, world in WORLDS.items():
        rows = []
        for seed in range(seeds):
            node, azimuth, *_ = world(seed)
            record, _ = build_axis_record(node, "x", None, LATITUDE, GyroAngleOptions(0.01))
            result = find_north([record], LATITUDE, "maytag4")
            nearest_error = wrap_angle(result.filters["nearest"].azimuth - azimuth)
            rows.append(
                [wrap_angle(result.azimuth - azimuth), result.sigma, result.angle_sigma, nearest_error]
            )
        error, sigma, angles, nearest_error = np.degrees(np.array(rows, float)).T
        z = np.abs(error / sigma)
        print(
            f"{name:9s} {rms(error):4.1f} {rms(sigma):6.1f} {rms(angles):8.1f} {np.mean(z**2):8.2f} "
            f"{np.mean(z < 1):9.2f} {np.mean(z < 2):5.2f} {rms(nearest_error):15.1f}",
            flush=True,
        )
    print(f"processor {time.process_time() - start:.0f} s")


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


if __name__ == "__main__":
    main()
