"""Robert 2014, thesis beside ours: how well two MEMS gyros measure Earth rate, and find north with it.

.venv/bin/python tests/papers/robert.py [--seeds N] [--static FOLDER]
"""

import argparse
import os
import sys
import time
from pathlib import Path

# Small matrices: threads of the linear algebra only wait for each other, and for any busy core.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.north_table import Sensor, carousel, maytag
from hubodo.errors import InputError
from hubodo.log.csv_folder import read_folder
from hubodo.sensors.north.advice import best_programme, ergodicity, time_for, white_azimuth_bound
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.circle import fuse, wrap
from hubodo.sensors.north.drift import Drift
from hubodo.sensors.north.east import seek_east
from hubodo.sensors.north.filters import FILTERS, opposite_pairs
from hubodo.sensors.north.find import find_north, horizontal_rate
from hubodo.sensors.north.simulated_table import SimulatedTable, simulate_stops
from hubodo.sensors.north.stops import TableMotion

LATITUDE = np.radians(32.7574)
DT, TURN, SETTLE = 0.1, 2.0, 1.5
HORIZONTAL = horizontal_rate(LATITUDE)


def with_minimum(n, lowest, at):
    """Sensor whose Allan deviation is lowest, `lowest` deg/h, at `at` s, with n in deg/sqrt(h).

    At the minimum random walk and white noise contribute alike: K² tau / 3 = N² / tau; flicker makes up the
    rest.
    """
    white = (60 * n) / np.sqrt(at)
    flicker = np.sqrt(max(lowest**2 - 2 * white**2, 0)) / np.sqrt(2 * np.log(2) / np.pi)
    return Sensor(n, flicker, np.sqrt(3) * (60 * n) / at * 60)


# N of the ADXRS646: 0.01 deg/s/sqrt(Hz) of its data sheet, one-sided, so N = 0.01/sqrt(2) deg/sqrt(s). Of
# the STIM210: 0.15 deg/sqrt(h); the thesis' own 1.6 deg/h at 16.4 s would be 0.11. 0.57 deg/h at 1000 s:
# flicker of 0.4, 0.5 with white noise or random walk beside it, as nearly as one number can say.
ADXRS646 = with_minimum(0.01 / np.sqrt(2) * 60, 12.0, 34.0)
STIM210 = with_minimum(0.15, 0.57, 1000.0)


def drift_of(sensor):
    return Drift(np.radians(sensor.n) / 60, np.radians(sensor.b) / 3600, np.radians(sensor.k) / 3600 / 60)


def table_of(run):
    return TableMotion(run.table_t, run.table_angle, run.table_moving)


def record_of(run):
    return AxisRecord(run.t, run.rate, table_of(run))


def programme(sensor, seed, azimuth, angles, stop):
    rng = np.random.default_rng(seed)
    count = int((len(angles) * (stop + TURN)) / DT) + 10
    return maytag(
        sensor.error(count, DT, rng),
        DT,
        azimuth,
        LATITUDE,
        list(angles),
        stop,
        TURN,
        transient=0.003,
        rng=rng,
    )


def two_point(name, sensor, stop, stops, seeds, thesis):
    """Table zero due north as in the thesis: percent error of the measured Earth rate."""
    angles = np.resize([0.0, np.pi], stops)
    errors, sigmas = [], []
    for seed in range(seeds):
        run = programme(sensor, seed, 0.0, angles, stop)
        found = find_north([record_of(run)], LATITUDE, "maytag", settle=SETTLE, near=0.0)
        rate, sigma = found.components()
        filters = [found.filters[f].rate[0] for f in FILTERS]
        errors.append([rate[0] - HORIZONTAL, *(f - HORIZONTAL for f in filters)])
        sigmas.append(sigma[0])
    errors = np.array(errors) / HORIZONTAL * 100
    sigmas = np.array(sigmas) / HORIZONTAL * 100
    bound = drift_of(sensor).n / np.sqrt(stop * stops) / HORIZONTAL * 100
    print(
        f"\n{name}: N {sensor.n:.3f} deg/sqrt(h), B {sensor.b:.2f} deg/h, K {sensor.k:.1f} deg/h/sqrt(h); "
        f"{stops} stops of {stop:.0f} s, {seeds} seeds from 0"
    )
    print(f"  white-noise bound on Earth rate {bound:.2f} %; thesis: {thesis}")
    print(f"  {'':22s} rms %   mean |%|  median |%|  95th |%|   rms against ours (paired, 1 sigma)")
    for k, label in enumerate(("maximum likelihood", *FILTERS)):
        off = np.abs(errors[:, k])
        ratio, spread = paired(errors[:, k], errors[:, 0])
        print(
            f"  {label:22s} {rms(off):6.2f} {off.mean():9.2f} {np.median(off):11.2f} "
            f"{np.quantile(off, 0.95):9.2f}"
            f"   {ratio:.3f} ± {spread:.3f}"
        )
    print(
        f"  sigma of ours {rms(sigmas):.2f} %, rms of error/sigma {rms(errors[:, 0] / sigmas):.2f}, "
        f"inside 1 and 2 sigma {np.mean(np.abs(errors[:, 0]) < sigmas):.2f} "
        f"{np.mean(np.abs(errors[:, 0]) < 2 * sigmas):.2f}"
    )
    means = np.abs(errors[: seeds // 5 * 5, 0]).reshape(-1, 5).mean(axis=1)
    nearest = np.abs(errors[: seeds // 5 * 5, 1]).reshape(-1, 5).mean(axis=1)
    print(
        f"  mean of five data sets as in the thesis, 5..95 %: nearest neighbour "
        f"{np.quantile(nearest, 0.05):.1f}.."
        f"{np.quantile(nearest, 0.95):.1f} %, ours "
        f"{np.quantile(means, 0.05):.1f}..{np.quantile(means, 0.95):.1f} %"
    )
    return errors, sigmas


def four_point(name, sensor, stop, stops, seeds):
    """Any azimuth: error in degrees, honesty of sigma, and four gyros fused."""
    angles = np.resize([0.0, np.pi, np.pi / 2, 1.5 * np.pi], stops)
    rows, fused = [], []
    for seed in range(seeds):
        azimuth = np.random.default_rng(10_000 + seed).uniform(-np.pi, np.pi)
        found = []
        for gyro in range(4 if seed % 4 == 0 else 1):
            run = programme(sensor, 20_000 + 4 * seed + gyro, azimuth, angles, stop)
            found.append(find_north([record_of(run)], LATITUDE, "maytag4", settle=SETTLE))
        first = found[0]
        off = [wrap(first.azimuth - azimuth), *(wrap(first.filters[f].azimuth - azimuth) for f in FILTERS)]
        rows.append([*np.degrees(off), np.degrees(first.sigma), np.degrees(first.white_bound)])
        if len(found) == 4:
            together, sigma = fuse([(f.posterior, f.horizontal) for f in found])
            fused.append((np.degrees(wrap(together - azimuth)), np.degrees(sigma)))
    rows, fused = np.array(rows), np.array(fused)
    print(
        f"\n{name}, four points, {stops} stops of {stop:.0f} s, {seeds} seeds, random azimuths, degrees rms:"
    )
    print(
        f"  ours {rms(rows[:, 0]):.2f}, sigma {rms(rows[:, 6]):.2f}, error/sigma rms "
        f"{rms(rows[:, 0] / rows[:, 6]):.2f}, "
        f"white-noise bound {np.median(rows[:, 7]):.2f}"
    )
    for k, label in enumerate(FILTERS):
        ratio, spread = paired(rows[:, 1 + k], rows[:, 0])
        print(f"  {label:22s} {rms(rows[:, 1 + k]):.2f}   {ratio:.3f} ± {spread:.3f} of ours")
    print(f"  four gyros fused {rms(fused[:, 0]):.2f}, sigma {rms(fused[:, 1]):.2f} ({len(fused)} runs)")
    return rows


def moving(name, sensor, seeds):
    """Carousel and east-seeking in as much time as 20 stops of 34 s."""
    turned, east = [], []
    for seed in range(seeds):
        rng = np.random.default_rng(30_000 + seed)
        azimuth = rng.uniform(-np.pi, np.pi)
        run = carousel(sensor.error(7300, DT, rng), DT, azimuth, LATITUDE, 40.0, 720.0)
        found = find_north([record_of(run)], LATITUDE, "carousel")
        turned.append(np.degrees([wrap(found.azimuth - azimuth), found.sigma, found.white_bound]))
        table = SimulatedTable(sensor.error(9000, DT, rng), DT, azimuth, LATITUDE)
        loop = seek_east(table, table.measure, HORIZONTAL, steps=7)
        east.append(
            np.degrees([wrap(loop.azimuth - azimuth), loop.sigma, wrap(azimuth - loop.angle - np.pi / 2)])
        )
    turned, east = np.array(turned), np.array(east)
    print(
        f"\n{name}, 12 minutes, {seeds} seeds, degrees rms: carousel {rms(turned[:, 0]):.2f} (sigma "
        f"{rms(turned[:, 1]):.2f}, "
        f"white-noise bound {np.median(turned[:, 2]):.2f}); east-seeking loop {rms(east[:, 2]):.2f}, all "
        f"its stops together "
        f"{rms(east[:, 0]):.2f} (sigma {rms(east[:, 1]):.2f})"
    )


def ergodic(name, sensor, seed, stop=34.0, stops=1800):
    """1,799 estimates as in the thesis."""
    rng = np.random.default_rng(seed)
    width, gap = int(stop / DT), int(TURN / DT)
    error = sensor.error(stops * (width + gap), DT, rng).reshape(stops, width + gap)[:, :width].mean(axis=1)
    sign = np.where(np.arange(stops) % 2 == 0, 1, -1)
    found = ergodicity(opposite_pairs(sign).rates(error + sign * HORIZONTAL))
    print(
        f"{name}: Allan deviation of {stops - 1} estimates falls with slope {found.slope:.3f} ± "
        f"{found.sigma:.3f} "
        f"(thesis: -1/2), seed {seed}"
    )


def minute(name, sensor):
    drift = drift_of(sensor)
    one = best_programme(drift, 60.0, TURN, HORIZONTAL)
    three, degree = (time_for(drift, np.radians(d), TURN, HORIZONTAL) for d in (3.0, 1.0))
    bound = np.degrees(white_azimuth_bound(drift.n, 60.0, HORIZONTAL))
    verdict = (
        f"{np.degrees(one.sigma):.1f} deg, {one.count} stops of {one.stop:.0f} s"
        if one.sigma < 0.8
        else "no north"
    )
    words = [f"{a.time / 60:.0f} min" if a else "more than a day" for a in (three, degree)]
    print(
        f"{name}: one minute gives {verdict}; its white-noise bound {bound:.1f} deg; 3 deg takes "
        f"{words[0]}, 1 deg {words[1]}"
    )


def real_noise(folder, seeds):
    """The recorded error of an ADIS16405 at rest, cut into runs, as a gyro on a simulated table."""
    node = read_folder(folder).nodes["node"]
    dt = float(np.median(np.diff(node.t)))
    rows = []
    for axis in range(3):
        error = node.gyro[:, axis]
        for part, azimuth in zip(np.array_split(error, seeds), np.linspace(-3, 3, seeds), strict=True):
            table = SimulatedTable(part, dt, azimuth, LATITUDE)
            angles = np.resize([0.0, np.pi, np.pi / 2, 1.5 * np.pi], int(len(part) * dt / 36.0) - 1)
            t, rate, made = simulate_stops(table, angles, 34.0)
            found = find_north([AxisRecord(t, rate, made)], LATITUDE, "maytag4", settle=SETTLE)
            off = [
                wrap(found.azimuth - azimuth),
                *(wrap(found.filters[f].azimuth - azimuth) for f in FILTERS),
            ]
            rows.append([*np.degrees(off), np.degrees(found.sigma), np.degrees(found.white_bound), t[-1]])
    rows = np.array(rows)
    print(
        f"\nreal noise, {len(rows)} runs of {rows[0, -1] / 60:.0f} min (three axes), four points, degrees "
        f"rms: ours "
        f"{rms(rows[:, 0]):.1f}, sigma {rms(rows[:, 6]):.1f}, error/sigma rms "
        f"{rms(rows[:, 0] / rows[:, 6]):.2f}, "
        f"white-noise bound {np.median(rows[:, 7]):.1f}; "
        + ", ".join(f"{f} {rms(rows[:, 1 + k]):.1f}" for k, f in enumerate(FILTERS))
    )


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def paired(theirs, ours):
    """Ratio of both rms and its standard deviation, by the jackknife over seeds."""
    ratio = rms(theirs) / rms(ours)
    a, b = np.square(theirs), np.square(ours)
    left = np.sqrt((a.sum() - a) / (b.sum() - b))
    return ratio, float(np.sqrt((len(a) - 1) * np.mean((left - left.mean()) ** 2)))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=240)
    parser.add_argument("--static", type=Path, help="CSV folder of a node at rest")
    args = parser.parse_args()
    begin = time.time()
    print(
        f"Robert 2014 at latitude 32.7574 deg: horizontal Earth rate {np.degrees(HORIZONTAL):.6f} deg/s "
        f"(thesis 0.0035)"
    )
    two_point(
        "ADXRS646-like", ADXRS646, 34.0, 20, args.seeds, "10.9 % (table on its legs), 16.6 % (floating)"
    )
    two_point("STIM210-like", STIM210, 16.0, 200, args.seeds, 'no percentage given, "more accurate"')
    four_point("ADXRS646-like", ADXRS646, 34.0, 20, args.seeds // 2)
    four_point("STIM210-like", STIM210, 16.0, 40, args.seeds // 2)
    moving("ADXRS646-like", ADXRS646, args.seeds // 4)
    moving("STIM210-like", STIM210, args.seeds // 4)
    print()
    ergodic("ADXRS646-like", ADXRS646, 1)
    for name, sensor in (
        ("ADXRS646-like", ADXRS646),
        ("STIM210-like", STIM210),
        ("0.01 deg/sqrt(h), 0.05 deg/h", with_minimum(0.01, 0.05, 1000)),
    ):
        minute(name, sensor)
    shared = (
        Path(os.environ.get("HUBODO_SHARED", Path(__file__).resolve().parents[3] / "shared"))
        / "data"
        / "static"
    )
    try:
        real_noise(args.static or shared, 5)
    except InputError as error:
        print(f"real noise left out: {error}")
    print(f"both percentages of the thesis are of the ADXRS646; run time {time.time() - begin:.0f} s")


if __name__ == "__main__":
    main()
