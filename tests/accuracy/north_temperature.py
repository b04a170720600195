"""North with a gyro whose bias follows the temperature: coverage and sigma with and without a thermometer.

    python tests/accuracy/north_temperature.py [--seeds 20] [--first 0]

24 stops of 20 s in four directions, table with angles; the temperature swings by some degrees at the rate of
the programme, the least favourable one. Columns: share of azimuth errors within 1.96 sigma with its binomial
95 % interval, rms error and rms sigma in degrees, records whose temperature is used; "bound": Cramér-Rao for
the simulated white noise, with unknown bias, ramp and temperature.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from imu_records import coverage, rms

from generators.north_table import Sensor, maytag
from hubodo.errors import HubodoError
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.north_estimate import find_north
from hubodo.sensors.north.stops import TableMotion
from script_arguments import script_parser

LATITUDE, DT, STOP, TURN = np.radians(50.0), 0.1, 20.0, 3.0
DEG_H = np.radians(1.0) / 3600.0
ANGLES = np.radians(np.cumsum([0.0, *([180.0, -90.0, 180.0, -270.0] * 6)[:23]]))
SENSOR = Sensor(n=0.06, b=0.5, k=0.5)
ROWS = (
    ("constant temperature", 0.0, 0.0),
    ("swings by 3 °C, bias ignores it", 3.0, 0.0),
    ("swings by 3 °C, 10 deg/h a degree", 3.0, 10.0),
    ("swings by 3 °C, 100 deg/h a degree", 3.0, 100.0),
)


def record(rng, azimuth, swing, slope):
    count = round((STOP + TURN) * len(ANGLES) / DT) + 10
    t = np.arange(count) * DT
    period = rng.uniform(2.0, 6.0) * (STOP + TURN)
    warmth = swing * np.sin(2.0 * np.pi * (t / period + rng.uniform()))
    error = SENSOR.error(count, DT, rng) + slope * DEG_H * warmth
    run = maytag(error, DT, azimuth, LATITUDE, ANGLES, STOP, TURN)
    temperature = 30.0 + warmth[: len(run.t)] + 0.02 * rng.standard_normal(len(run.t))
    return run, temperature


def bound(run, temperature, azimuth):
    """Return the Cramér-Rao 1σ of the azimuth, rad, for white noise."""
    row = np.clip(np.searchsorted(run.table_t, run.t, side="right") - 1, 0, len(run.table_t) - 1)
    still = ~run.table_moving[row]
    angle = np.interp(run.t, run.table_t, run.table_angle)
    across = 15.041067 * DEG_H * np.cos(LATITUDE) * np.sin(azimuth - angle)
    nuisance = np.column_stack([np.ones(len(run.t)), run.t, temperature])[still]
    q = np.linalg.qr(nuisance)[0]
    left = across[still] - q @ (q.T @ across[still])
    sample = SENSOR.n / 60.0 * np.pi / 180.0 / np.sqrt(DT)
    return sample / np.linalg.norm(left)


def main():
    parser = script_parser(__doc__, seeds=20, first=0)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    print(f"seeds {seeds[0]} to {seeds[-1]}")
    head = f"{'error':>7s} {'sigma':>7s} {'bound':>7s} used refused"
    print(f"{'':36s} {'thermometer':11s} {'coverage':>20s} {head}")
    for name, swing, slope in ROWS:
        rows = {True: [], False: []}
        limits, refused = [], {True: 0, False: 0}
        for seed in seeds:
            rng = np.random.default_rng([seed, round(slope), round(swing)])
            azimuth = rng.uniform(0.0, 2.0 * np.pi)
            run, temperature = record(rng, azimuth, swing, slope)
            limits.append(bound(run, temperature, azimuth))
            motion = TableMotion(run.table_t, run.table_angle, run.table_moving)
            for with_it in rows:
                axis = AxisRecord(run.t, run.rate, motion, temperature=temperature if with_it else None)
                try:
                    result = find_north([axis], LATITUDE, "maytag4", near=azimuth)
                except HubodoError:
                    refused[with_it] += 1
                    continue
                error = (result.azimuth - azimuth + np.pi) % (2.0 * np.pi) - np.pi
                rows[with_it].append((error, result.sigma, result.posterior.uses_temperature))
        for with_it, values in rows.items():
            error, sigma, used = np.array(values, float).T
            print(
                f"{name:36s} {'yes' if with_it else 'no':11s} {coverage(error / sigma)} "
                f"{np.degrees(rms(error)):7.2f} {np.degrees(rms(sigma)):7.2f} {np.degrees(rms(limits)):7.2f} "
                f"{int(used.sum()):4d} {refused[with_it]:7d}",
                flush=True,
            )


if __name__ == "__main__":
    main()
