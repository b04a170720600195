"""North by carousel with standstills and cross-axis rates, and by four directions: error, sigma and bound.

    python tests/accuracy/north_methods.py [--seeds 20] [--first 0]

Records are by `generators/table_record.py`, with table.csv. "bound": Cramér-Rao, from the covariance of the
simulated noise, with unknown bias and cross-axis share; "stated": the bound of the result, from the noise it
estimates. "plain": least squares of cosine, sine and bias through all samples. Coverage: share of errors
within 1.96 sigma, with its binomial 95 % interval.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from imu_records import coverage, rms

from generators.table_record import DEG_H, EARTH_RATE, Carousel, table_record, table_rows
from generators.table_worlds import LATITUDE, NOISE, even
from hubodo.errors import HubodoError
from hubodo.recording import Recording, Table
from hubodo.sensors.north.from_recordings import NorthOptions, north_from_recordings
from script_arguments import script_parser

HZ = 10.0
HORIZONTAL = EARTH_RATE * np.cos(LATITUDE)
GOOD = {"n": np.radians(0.002), "b": 0.5 * DEG_H, "k": 1e-8}
CAROUSELS = {
    "carousel at 10 deg/s, no standstill": (Carousel(0.0, 300.0, 0.0, 10.0), {}),
    "carousel at 10 deg/s, standstills of 20 s": (Carousel(20.0, 300.0, 20.0, 10.0), {}),
    "the same, cross-axis 1 %": (Carousel(20.0, 300.0, 20.0, 10.0, ripple=0.01), {"cross_axis": 0.01}),
    "carousel at 20 deg/s, cross-axis 1 %": (
        Carousel(20.0, 150.0, 20.0, 20.0, ripple=0.01),
        {"cross_axis": 0.01},
    ),
}
STOPS = {
    "four directions, 12 stops of 20 s": (even(), {}),
    "four directions, the same, flicker of 3 deg/h": (even(), {"noise": {**NOISE, "b": 3 * DEG_H}}),
    "four directions, 24 stops of 30 s": (even(24, [180, -90, 180, -270] * 6, stop=30.0), {}),
}


def azimuth_bound(t, angle, used, spin, azimuth, noise):
    """Return the Cramér-Rao 1σ of the azimuth, rad, from means of 1 s that lie in `used` (N,) throughout."""
    block = round(HZ)
    count = len(t) // block
    means = np.kron(np.eye(count), np.full(block, 1 / block))[
        used[: count * block].reshape(count, block).all(1)
    ]
    length = count * block
    steps = np.arange(1, length)
    flicker = np.concatenate([[1.0], np.cumprod((steps - 0.5) / steps)])
    covariance = noise["n"] ** 2 * HZ * means @ means.T
    for response in (noise["b"] * flicker, noise["k"] / np.sqrt(HZ) * np.ones(length)):
        # A mean of correlated noise is a sum over the white noise that drives it.
        sums = fftconvolve(means[:, ::-1], response[None], axes=1)[:, :length]
        covariance += sums @ sums.T
    slope = HORIZONTAL * np.sin(angle[:length] - azimuth)
    columns = [means @ slope, means.sum(axis=1)] + (
        [means @ spin[:length]] if np.any(means @ spin[:length]) else []
    )
    x = np.column_stack(columns)
    x = x / np.linalg.norm(x, axis=0)
    information = x.T @ np.linalg.solve(covariance, x)
    return np.sqrt(np.linalg.inv(information)[0, 0]) / np.linalg.norm(columns[0])


def trial(programme, method, world, *seed):
    """Return error, sigma, bound, the result's own bound and the error of the plain method, rad."""
    rng = np.random.default_rng([61, *seed])
    azimuth = rng.uniform(-np.pi, np.pi)
    world = {"noise": GOOD if method == "carousel" else NOISE} | world
    t, gyro, accel, stood = table_record(programme, rng, azimuth=azimuth, latitude=LATITUDE, hz=HZ, **world)
    node = dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True))
    table = dict(zip(("t", "angle", "moving"), table_rows(programme), strict=True))
    log = Recording({"imu": Table(node)}, table=Table(table))
    result = north_from_recordings([("log", log)], ["imu"], NorthOptions(np.degrees(LATITUDE), ["x"], method))
    angle, _ = programme.angle(t)
    at_stop = ((t[:, None] >= stood[:, 0] + 0.5) & (t[:, None] < stood[:, 1] - 0.5)).any(axis=1)
    used = ~at_stop if method == "carousel" else at_stop
    inside = (t > t[0] + 3.0) & (t < t[-1] - 3.0) if method == "carousel" else used
    wave = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(t))])[used & inside]
    c, s, _ = np.linalg.lstsq(wave, gyro[used & inside, 0], rcond=None)[0]
    spin = np.gradient(angle, t)

    bound = azimuth_bound(t, angle, used | (method == "carousel"), spin, azimuth, world["noise"])
    plain = np.arctan2(s, c) - azimuth
    return wrap(result.azimuth - azimuth), result.sigma, bound, result.gyros[0].bound, wrap(plain)


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def main():
    args = script_parser(__doc__, seeds=20, first=0).parse_args()
    seeds = range(args.first, args.first + args.seeds)
    print(f"latitude 45 degrees, {HZ:g} Hz, seeds {seeds[0]} to {seeds[-1]}; degrees, rms")
    print(
        f"{'':48s} {'coverage':>20s} {'error':>7s} {'sigma':>7s} {'bound':>7s} {'stated':>7s} {'plain':>7s}"
    )
    for number, (name, (programme, world)) in enumerate((CAROUSELS | STOPS).items()):
        method = "carousel" if name in CAROUSELS else "maytag4"
        rows, refused = [], 0
        for seed in seeds:
            try:
                rows.append(trial(programme, method, world, seed, number))
            except HubodoError:
                refused += 1
        columns = np.array(rows).T
        cells = " ".join(f"{np.degrees(rms(column)):7.2f}" for column in columns)
        print(f"{name:48s} {coverage(columns[0] / columns[1])} {cells}  refused {refused}", flush=True)


if __name__ == "__main__":
    main()
