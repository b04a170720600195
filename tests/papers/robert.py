"""Robert 2014, row by row: figures of the thesis, its method rebuilt, ours, and the Cramér-Rao bound.

.venv/bin/python tests/papers/robert.py [--seeds N] [--static FOLDER]
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

# With small matrices, threads of the linear algebra mostly wait for each other and for busy cores.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.noise import gyro_noise
from generators.north_table import Sensor, carousel, maytag
from hubodo.errors import InputError
from hubodo.log.csv_folder import read_folder
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.circular import fuse_azimuths, wrap_angle
from hubodo.sensors.north.drift import DriftNoise, drift_covariance
from hubodo.sensors.north.east import seek_east
from hubodo.sensors.north.filters import CLASSICAL_FILTERS, find_opposite_pairs
from hubodo.sensors.north.north_estimate import find_north, horizontal_earth_rate
from hubodo.sensors.north.programme import (
    find_best_programme,
    find_shortest_programme,
    fit_ergodicity,
    white_noise_azimuth_bound,
)
from hubodo.sensors.north.running_estimate import RunningEstimate
from hubodo.sensors.north.simulated_table import SimulatedTable, simulate_stops
from hubodo.sensors.north.stops import TableMotion

LATITUDE = np.radians(32.7574)
DT, TURN, SETTLE = 0.1, 2.0, 0.3
HORIZONTAL = horizontal_earth_rate(LATITUDE)
TWO, FOUR = (0.0, np.pi), (0.0, np.pi, np.pi / 2, 1.5 * np.pi)
DEG_H = np.pi / 180 / 3600


def with_minimum(n, lowest, at):
    """Return a sensor whose Allan deviation has a minimum of `lowest`, deg/h, at `at` s; n in deg/√h."""
    white = (60 * n) / np.sqrt(at)
    flicker = np.sqrt(max(lowest**2 - 2 * white**2, 0)) / np.sqrt(2 * np.log(2) / np.pi)
    return Sensor(n, flicker, np.sqrt(3) * (60 * n) / at * 60)


# N of the ADXRS646: 0.01 deg/s/sqrt(Hz) of its data sheet, one-sided, so N = 0.01/sqrt(2) deg/sqrt(s). Of
# the STIM210: 0.15 deg/sqrt(h); the thesis' own 1.6 deg/h at 16.4 s would be 0.11. 0.57 deg/h at 1000 s:
# flicker of 0.4, 0.5 with white noise or random walk beside it, as nearly as one number can say.
ADXRS646 = with_minimum(0.01 / np.sqrt(2) * 60, 12.0, 34.0)
STIM210 = with_minimum(0.15, 0.57, 1000.0)


@dataclass(frozen=True)
class Noise:
    """Gyro noise generated without any code of hubodo; N, B, K, R in SI units."""

    n: float
    b: float = 0.0
    k: float = 0.0
    r: float = 0.0

    def error(self, count, dt, rng):
        return gyro_noise(count, dt, rng, n=self.n, b=self.b, k=self.k, r=self.r)


def drift_of(sensor):
    if isinstance(sensor, Noise):
        return DriftNoise(sensor.n, sensor.b, sensor.k)
    return DriftNoise(
        np.radians(sensor.n) / 60, np.radians(sensor.b) / 3600, np.radians(sensor.k) / 3600 / 60
    )


def record_of(run):
    return AxisRecord(run.t, run.rate, TableMotion(run.table_t, run.table_angle, run.table_moving))


def programme(sensor, seed, azimuth, directions, stop, stops):
    rng = np.random.default_rng(seed)
    angles = np.resize(directions, stops)
    error = sensor.error(int(stops * (stop + TURN) / DT) + 10, DT, rng)
    return record_of(maytag(error, DT, azimuth, LATITUDE, list(angles), stop, TURN, rng=rng))


def oracle(result, sensor):
    """Return estimate and covariance of the observed components by least squares with the true noise.

    The covariance is the Cramér-Rao bound; bias and ramp are unknown, as for our estimator.
    """
    return oracle_of(result.averages[0], sensor)


def oracle_of(a, sensor):
    inverse = np.linalg.inv(drift_covariance(drift_of(sensor), a.start, a.end))
    observed = [a.cos, a.sin] if np.ptp(a.sin) > 0.1 else [a.cos]
    x = np.column_stack([*observed, np.ones(len(a.y)), a.start - a.start.mean()])
    spread = np.linalg.inv(x.T @ inverse @ x)
    return (spread @ x.T @ inverse @ a.y)[: len(observed)], spread[: len(observed), : len(observed)]


def azimuth_oracle(result, sensor, azimuth):
    """Return the azimuth error and its bound, rad, of the oracle, which knows the Earth rate."""
    return azimuth_oracle_of(result.averages[0], sensor, azimuth)


def azimuth_oracle_of(averages, sensor, azimuth):
    rate, spread = oracle_of(averages, sensor)
    angles = azimuth + np.radians(np.arange(-60, 60, 0.02))
    off = HORIZONTAL * np.stack([np.cos(angles), np.sin(angles)]) - rate[:, None]
    information = np.linalg.inv(spread)
    best = angles[np.einsum("ik,ij,jk->k", off, information, off).argmin()]
    across = HORIZONTAL * np.array([-np.sin(azimuth), np.cos(azimuth)])
    return float(wrap_angle(best - azimuth)), float(1 / np.sqrt(across @ information @ across))


def two_point(sensor, stop, stops, seeds):
    """Return errors in % of Earth rate: nearest neighbour, ours, sigma, oracle, other filters; bound."""
    rows = []
    for seed in range(seeds):
        record = programme(sensor, seed, 0.0, TWO, stop, stops)
        result = find_north([record], LATITUDE, "maytag", settle=SETTLE, near=0.0)
        rate, sigma = result.rate_components()
        reported, spread = oracle(result, sensor)
        others = [result.filters[name].rate[0] for name in CLASSICAL_FILTERS]
        rows.append([others[0], rate[0], sigma[0] + HORIZONTAL, reported[0], *others[1:]])
    return (np.array(rows) / HORIZONTAL - 1) * 100, float(np.sqrt(spread[0, 0])) / HORIZONTAL * 100


def four_point(sensor, stop, stops, seeds, first=20_000):
    """Return degrees (seeds, 5): nearest neighbour, ours, sigma, oracle, bound; and the posteriors."""
    rows, retained = [], []
    for seed in range(seeds):
        azimuth = np.random.default_rng(10_000 + seed // 4).uniform(-np.pi, np.pi)
        record = programme(sensor, first + seed, azimuth, FOUR, stop, stops)
        result = find_north([record], LATITUDE, "maytag4", settle=SETTLE)
        theirs = result.filters["nearest"].azimuth
        rows.append(
            [
                float(wrap_angle(theirs - azimuth)),
                float(wrap_angle(result.azimuth - azimuth)),
                result.sigma,
                *azimuth_oracle(result, sensor, azimuth),
            ]
        )
        retained.append((result, azimuth))
    return np.degrees(np.array(rows)), retained


def maytag_rows(seeds):
    adxrs, bound = two_point(ADXRS646, 34.0, 20, seeds)
    row(
        "maytag 2, ADXRS646, 20 stops of 34 s, % of Earth rate",
        "10.9 (legs), 16.6 (floating)",
        adxrs[:, 0],
        adxrs[:, 1],
        bound,
        adxrs[:, 3],
    )
    sigma(adxrs[:, 1], adxrs[:, 2])
    best = find_best_programme(drift_of(ADXRS646), 20 * 36.0 - TURN, TURN, HORIZONTAL)
    short, bound = two_point(ADXRS646, best.stop, best.count, seeds)
    row(
        f"  the same 12 min as advised: {best.count} stops of {best.stop:g} s",
        "-",
        short[:, 0],
        short[:, 1],
        bound,
        short[:, 3],
    )
    for k, name in enumerate(CLASSICAL_FILTERS[1:]):
        ratio, spread = paired(adxrs[:, 4 + k], adxrs[:, 0])
        print(
            f"  {name.replace('_', ' ')}: {rms(adxrs[:, 4 + k]):.1f}, {ratio:.3f} ± {spread:.3f} of nearest"
        )
    stim, bound = two_point(STIM210, 16.0, 200, seeds // 4)
    row(
        "maytag 2, STIM210, 200 stops of 16 s, %",
        '"more accurate"',
        stim[:, 0],
        stim[:, 1],
        bound,
        stim[:, 3],
    )
    four, retained = four_point(ADXRS646, 34.0, 20, seeds)
    row("maytag 4, ADXRS646, 20 stops of 34 s, deg", "-", four[:, 0], four[:, 1], four[:, 4], four[:, 3])
    sigma(four[:, 1], four[:, 2])
    stim, _ = four_point(STIM210, 16.0, 40, seeds // 2)
    row("maytag 4, STIM210, 40 stops of 16 s, deg", "-", stim[:, 0], stim[:, 1], stim[:, 4], stim[:, 3])
    sigma(stim[:, 1], stim[:, 2])
    several(retained, four)


def several(retained, four):
    """Compare the mean of four gyros on one table, as in the thesis, with ours."""
    rows = []
    for k in range(0, len(retained) - 3, 4):
        result = [north for north, _ in retained[k : k + 4]]
        azimuth = retained[k][1]
        mean = np.mean([north.filters["nearest"].rate for north in result], axis=0)
        ours, spread = fuse_azimuths([(north.posterior, north.horizontal) for north in result])
        theirs = wrap_angle(np.arctan2(mean[1], mean[0]) - azimuth)
        bound = rms(four[k : k + 4, 4]) / 2
        rows.append([*np.degrees([theirs, wrap_angle(ours - azimuth), spread]), bound])
    rows = np.array(rows)
    row("four gyros at once, maytag 4, ADXRS646, deg", '"1/sqrt(n)"', rows[:, 0], rows[:, 1], rows[:, 3])
    sigma(rows[:, 1], rows[:, 2])


def moving_rows(name, sensor, seeds):
    """Carousel and east-seeking in the time of 20 stops of 34 s, degrees."""
    turned, east = [], []
    for seed in range(seeds):
        rng = np.random.default_rng(30_000 + seed)
        azimuth = rng.uniform(-np.pi, np.pi)
        record = record_of(carousel(sensor.error(7300, DT, rng), DT, azimuth, LATITUDE, 40.0, 720.0))
        result = find_north([record], LATITUDE, "carousel")
        angle = record.table.angle_at(record.t)
        wave = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(angle))])
        c, s, _ = np.linalg.lstsq(wave, record.rate, rcond=None)[0]
        turned.append(
            [
                wrap_angle(np.arctan2(s, c) - azimuth),
                wrap_angle(result.azimuth - azimuth),
                result.sigma,
                *azimuth_oracle(result, sensor, azimuth),
            ]
        )
        table = SimulatedTable(sensor.error(9000, DT, rng), DT, azimuth, LATITUDE)
        tally = RunningEstimate(HORIZONTAL)
        loop = seek_east(table, table.measure, HORIZONTAL, steps=7, tally=tally)
        east.append(
            [
                wrap_angle(azimuth - loop.angle - np.pi / 2),
                wrap_angle(loop.azimuth - azimuth),
                loop.sigma,
                *azimuth_oracle_of(tally.averages(), sensor, azimuth),
            ]
        )
    turned, east = np.degrees(np.array(turned)), np.degrees(np.array(east))
    thesis = '"useless"' if name == "ADXRS646" else "-"
    row(f"carousel, {name}, 40 s a turn, deg", thesis, turned[:, 0], turned[:, 1], turned[:, 4], turned[:, 3])
    sigma(turned[:, 1], turned[:, 2])
    what = f"east-seeking, {name}, 21 stops of 34 s, deg"
    row(what, "-", east[:, 0], east[:, 1], east[:, 4], east[:, 3])
    sigma(east[:, 1], east[:, 2])


def noise_rows(seeds):
    """Print white noise, flicker, walk and ramp by another generator: ours over the bound, and sigma."""
    n, b, k = 3e-5, 3e-6, 1e-6
    for name, noise in (
        ("white noise", Noise(n)),
        ("flicker", Noise(n, b=4 * b)),
        ("random walk", Noise(n, k=k)),
        ("ramp", Noise(n, r=2e-7)),
        ("all of them", Noise(n, 2 * b, k, 1e-7)),
    ):
        rows, _ = four_point(noise, 20.0, 24, seeds, first=70_000)
        row(f"maytag 4, {name}, 24 stops of 20 s, deg", "-", rows[:, 0], rows[:, 1], rows[:, 4], rows[:, 3])
        sigma(rows[:, 1], rows[:, 2])


def row(what, paper, theirs, ours, bound, reported=None):
    """Print one line of the table; reported: errors of an estimator that knows the noise, on the same
    records.
    """
    bound = rms(np.atleast_1d(bound))
    line = f"{what:56s} | {paper:28s} | {rms(theirs):7.2f} | {rms(ours):6.2f} | {bound:6.2f} |"
    if reported is not None:
        ratio, spread = paired(ours, reported)
        line += f" {ratio:.3f} ± {spread:.3f} of who knows the noise;"
    ratio, spread = paired(theirs, ours)
    print(f"{line} the thesis' way {ratio:.3f} ± {spread:.3f} of ours ({len(ours)} seeds)", flush=True)


def sigma(errors, sigmas):
    """Print the consistency of sigma: NEES (expected 1), and the shares within one and two sigma."""
    z = errors / sigmas
    print(
        f"  sigma {rms(sigmas):.2f}, NEES {np.mean(z**2):.2f}, "
        f"inside 1 and 2 sigma {np.mean(np.abs(z) < 1):.2f} {np.mean(np.abs(z) < 2):.2f}"
    )


def ergodic(name, sensor, seed, stop=34.0, stops=1800):
    """Return 1,799 estimates as in the thesis."""
    rng = np.random.default_rng(seed)
    width, gap = int(stop / DT), int(TURN / DT)
    error = sensor.error(stops * (width + gap), DT, rng).reshape(stops, width + gap)[:, :width].mean(axis=1)
    sign = np.where(np.arange(stops) % 2 == 0, 1, -1)
    result = fit_ergodicity(find_opposite_pairs(sign).rates(error + sign * HORIZONTAL))
    print(
        f"{name}: Allan deviation of {stops - 1} estimates falls with slope {result.slope:.3f} ± "
        f"{result.sigma:.3f} (thesis: -1/2), seed {seed}"
    )


def minute(name, sensor):
    drift = drift_of(sensor)
    one = find_best_programme(drift, 60.0, TURN, HORIZONTAL)
    three, degree = (find_shortest_programme(drift, np.radians(d), TURN, HORIZONTAL) for d in (3.0, 1.0))
    bound = np.degrees(white_noise_azimuth_bound(drift.n, 60.0, HORIZONTAL))
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


def real_noise(folder, parts):
    """Use the recorded error of an ADIS16405 at standstill, cut into runs, as a gyro on a simulated table."""
    node = read_folder(folder).nodes["node"]
    dt = float(np.median(np.diff(node.t)))
    rows = []
    for axis in range(3):
        error = node.gyro[:, axis]
        for part, azimuth in zip(np.array_split(error, parts), np.linspace(-3, 3, parts), strict=True):
            table = SimulatedTable(part, dt, azimuth, LATITUDE)
            angles = np.resize(FOUR, int(len(part) * dt / 36.0) - 1)
            t, rate, built = simulate_stops(table, angles, 34.0)
            result = find_north([AxisRecord(t, rate, built)], LATITUDE, "maytag4", settle=SETTLE)
            theirs = wrap_angle(result.filters["nearest"].azimuth - azimuth)
            rows.append([theirs, wrap_angle(result.azimuth - azimuth), result.sigma, result.bound])
    rows = np.degrees(np.array(rows))
    row(f"maytag 4, real ADIS16405, {t[-1] / 60:.0f} min, deg", "-", rows[:, 0], rows[:, 1], rows[:, 3])
    sigma(rows[:, 1], rows[:, 2])


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def paired(theirs, ours):
    """Return the ratio of both rms values and its standard deviation by the jackknife over seeds."""
    ratio = rms(theirs) / rms(ours)
    a, b = np.square(theirs), np.square(ours)
    left = np.sqrt((a.sum() - a) / (b.sum() - b))
    return ratio, float(np.sqrt((len(a) - 1) * np.mean((left - left.mean()) ** 2)))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=240)
    parser.add_argument("--static", type=Path, help="CSV folder of a node at rest")
    args = parser.parse_args()
    start = time.time()
    print(f"Robert 2014 at 32.7574 deg: Earth rate there {np.degrees(HORIZONTAL):.6f} deg/s (thesis 0.0035)")
    print(f"rms over seeds from 0, 10000, 20000, 30000, 70000 on; {args.seeds} of the longest\n")
    print(f"{'':56s} | {'paper':28s} | rebuilt | ours   | bound  |")
    maytag_rows(args.seeds)
    moving_rows("ADXRS646", ADXRS646, args.seeds // 4)
    moving_rows("STIM210", STIM210, args.seeds // 4)
    noise_rows(args.seeds)
    shared = Path(os.environ.get("HUBODO_SHARED", Path(__file__).resolve().parents[3] / "shared"))
    try:
        real_noise(args.static or shared / "data" / "static", 5)
    except InputError as error:
        print(f"real noise left out: {error}")
    print()
    ergodic("ADXRS646", ADXRS646, 1)
    for name, sensor in (
        ("ADXRS646", ADXRS646),
        ("STIM210", STIM210),
        ("0.01 deg/sqrt(h), 0.05 deg/h", with_minimum(0.01, 0.05, 1000)),
    ):
        minute(name, sensor)
    print(f"run time {time.time() - start:.0f} s, processor {time.process_time():.0f} s")


if __name__ == "__main__":
    main()
