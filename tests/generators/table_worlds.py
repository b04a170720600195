"""Typical records on a turntable by name, each drawn from a seed."""

import numpy as np

from generators.table_record import DEG_H, Programme, table_record
from hubodo.recording import Table

LATITUDE = np.radians(45)
NOISE = {"n": np.radians(0.003), "b": 1 * DEG_H, "k": 1e-8}
FOUR = [180, -90, 180, -270] * 3
"""Turns in degrees: four directions and back, so that no cable winds up."""


def recorded(seed, programme, *, noise=NOISE, scale=None, **world):
    """Return a node's table, the azimuth of table zero, the gyro scale error and the true stops."""
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(-np.pi, np.pi)
    scale = 0.01 * rng.standard_normal() if scale is None else scale
    t, gyro, accel, stood = table_record(
        programme, rng, azimuth=azimuth, latitude=LATITUDE, noise=noise, scale=scale, **world
    )
    columns = dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True))
    return Table(columns), azimuth, scale, stood


def even(stops=12, turns=FOUR, *, stop=20.0, rate=60.0):
    return Programme(turns[: stops - 1], [stop] * stops, [rate] * (stops - 1))


def odd(seed):
    """Return a programme with unequal stops, one cut short, slow and fast turns and a nudge."""
    rng = np.random.default_rng(1000 + seed)
    stops = [*rng.uniform(10, 40, 5), 2.5, *rng.uniform(10, 40, 6)]
    rates = list(rng.uniform(4, 180, 11))
    return Programme(FOUR[:11], stops, rates, [(stops[0] / 2, 1.3)])


def warming(seed):
    node, *truth = recorded(seed, even())
    columns = dict(node.columns)
    for name, size in (("gx", 0.3), ("gy", -0.2), ("gz", 0.4)):
        columns[name] = columns[name] + np.radians(size) * np.exp(-node.t / 120)
    return Table(columns), *truth


WORLDS = {
    "even": lambda seed: recorded(seed, even()),
    "odd": lambda seed: recorded(seed, odd(seed)),
    "onwards": lambda seed: recorded(seed, even(turns=[90] * 11)),
    "shaken": lambda seed: recorded(seed, even(), vibration=0.05),
    "drifting": lambda seed: recorded(seed, even(), noise={**NOISE, "b": 3 * DEG_H, "k": 3e-7, "r": 1e-7}),
    "leaning": lambda seed: recorded(seed, even(), elevation=0.2, lean=(0.03, -0.02)),
    "warming": warming,
}
"""even: as planned. odd: unequal stops, one cut short, turns of 4 to 180 deg/s, a nudge. onwards: always the
same way. shaken: 3 deg/s at 23.7 Hz. drifting: three times the flicker, walk and ramp. leaning: the table by
two degrees, the axis by eleven. warming: by half a degree per second in some minutes."""
