"""Records of a vertical gyro that turns at a new steady rate every 30 s, with or without standstills.

From first principles: the heading is the integral of the rate; gravity and Earth rate are vectors that rotate
with it. It shares nothing with the estimators.
"""

import numpy as np

from generators.noise import gyro_noise
from generators.table_record import DEG_H, EARTH_RATE

DEG = np.pi / 180


def steady_turns(
    seed,
    *,
    standstills=(0,),
    segments=10,
    length=30.0,
    first=None,
    fastest=25.0,
    lean=0.0,
    scale_sigma=0.0,
    warmup=0.0,
    hz=20.0,
):
    """Return t, gyro (N, 3), accel (N, 3) and the true heading (N,).

    standstills: numbers of the segments without rotation. first: duration of the first segment, s. fastest:
    largest rate, deg/s. lean: inclination of the rotation axis, degrees. scale_sigma: 1 sigma of the relative
    scale error. warmup: total warm-up of the bias, deg/s.
    """
    rng = np.random.default_rng(seed)
    rates = rng.uniform(-fastest, fastest, segments) * DEG
    rates[list(standstills)] = 0.0
    lengths = np.full(segments, length)
    lengths[0] = first or length
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    t = np.arange(0.0, edges[-1], 1.0 / hz)
    # Half a second at either end of a segment is needed for the change of the rate.
    knots = np.sort(np.concatenate([edges[:-1] + 0.5, edges[1:] - 0.5]))
    rate = np.interp(t, knots, np.repeat(rates, 2))
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) / hz])
    gyro = np.stack([gyro_noise(len(t), 1 / hz, rng, n=0.045 * DEG, b=20 * DEG_H) for _ in range(3)], axis=1)
    gyro += rng.normal(0.0, 0.5, 3) * DEG
    gyro[:, 0] += 0.7 * EARTH_RATE * np.cos(heading)
    gyro[:, 1] -= 0.7 * EARTH_RATE * np.sin(heading)
    gyro[:, 2] += (1.0 + scale_sigma * rng.standard_normal()) * rate
    gyro[:, 2] += warmup * DEG * (1.0 - np.exp(-t / 200.0))
    accel = np.array([0.05, -0.08, 9.9]) + 0.02 * rng.standard_normal((len(t), 3))
    accel[:, 0] += 9.8 * lean * DEG * np.cos(heading + 1.0)
    accel[:, 1] -= 9.8 * lean * DEG * np.sin(heading + 1.0)
    return t, gyro, accel, heading


WORLDS = {
    "start, 100 s": {"first": 100.0, "segments": 11},
    "start and end": {"standstills": (0, 9)},
    "start, table leans": {"lean": 0.1},
    "middle, table leans": {"standstills": (4,), "lean": 0.1},
    "three standstills": {"standstills": (2, 5, 8)},
    "none": {"standstills": ()},
    "none, table leans": {"standstills": (), "lean": 0.1},
    "none, slow": {"standstills": (), "fastest": 1.0},
}
"""Standstills of each record, and whether gravity shows the heading (a lean of 0.1 degrees)."""
