"""The START gyro of Barshan and Durrant-Whyte as it was used, with all that the paper states or shows.

It adds what `start_gyro.py` omits, without any code of hubodo; deg/s and s as in the paper. From the paper: a
room at 25 ± 2 degrees C with a thermostat; drift due to heating; 2,000 samples at rest within 1 to 2 s; a
residual that is white at 50 ms, hence a bandwidth of 10 Hz or more; an offset that differs from day to day; a
table with a new rate every 30 s, after which the orientation error is 36 degrees at most and 3.4 at the end.
The sizes of the resulting effects are ours.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from generators import start_gyro as start

DT = 0.01
BANDWIDTH = 10.0
"""Hz, one pole: the noise and what the gyro answers. Its noise of 0.2 deg/s is that of one sample."""
REST = 2.0
SCALE = 0.01
"""1 sigma; a table that is 36 degrees off after some 1,500 degrees of turn has about this."""
PER_DEGREE = 0.01
"""deg/s per degree C: C1 over some 30 degrees of heating; much more would show in the paper's whiteness."""
COURSE = 0.05
"""1 sigma, relative, by which C1 and T differ from one power-on to the next."""


@dataclass(frozen=True)
class Day:
    """One power-on: C1, T, the offset beside C2, swing of the room (degrees C, s, rad), scale error."""

    c1: float
    constant: float
    offset: float
    swing: float
    period: float
    phase: float
    scale: float

    def bias(self, age):
        """Return the bias, deg/s, at an age, s."""
        room = self.swing * np.sin(2.0 * np.pi * age / self.period + self.phase)
        return start.C2 + self.offset - self.c1 * np.expm1(-age / self.constant) + PER_DEGREE * room


def day(rng, offset=None):
    """Draw a power-on; offset: deg/s, None to draw it."""
    return Day(
        start.C1 * (1.0 + COURSE * rng.normal()),
        start.T * (1.0 + COURSE * rng.normal()),
        0.1 * rng.normal() if offset is None else offset,
        rng.uniform(0.3, 2.0),
        rng.uniform(1200.0, 3600.0),
        rng.uniform(0.0, 2.0 * np.pi),
        SCALE * rng.normal(),
    )


def sensed(one, age, rate, rng, dt=DT, noise=start.NOISE):
    """Return the digitised output of the gyro, deg/s, for the true rate (N,) at ages (N,), s."""
    keep = np.exp(-2.0 * np.pi * BANDWIDTH * dt)
    scatter = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.normal(0.0, noise, len(rate) + 50))[50:]
    late = lfilter([1.0 - keep], [1.0, -keep], rate, zi=[keep * rate[0]])[0]
    return start.digitise((1.0 + one.scale) * late + one.bias(age) + scatter)


def run(case, rng, seconds=300.0):
    """Return (t, true rate, output, day) of a rest and a drive that drift as in the paper."""
    age = start.AGES[case] + np.arange(round((REST + seconds) / DT)) * DT
    moving = round(REST / DT)
    rate = np.zeros(len(age))
    if case == "random rates":
        parts = np.array_split(np.arange(moving, len(age)), 10)
        for part, value in zip(parts, rng.uniform(-25.0, 25.0, 10), strict=True):
            rate[part] = value
    one = day(rng, 0.0)
    offset = start.DRIFTS_DEG[case] / 300.0 - one.bias(age[moving : moving + round(300.0 / DT)]).mean()
    one = Day(**{**vars(one), "offset": offset})
    return age - age[0], rate, sensed(one, age, rate, rng), one


def overnight(rng, step=5.0, duration=12 * 3600.0):
    """Return (t, output) at rest for a night from power-on, as means over `step` s, on a day of its own."""
    age = np.arange(0.0, duration, step)
    # The mean of a one-pole noise over 5 s has the variance 2 tau sigma^2 / 5 s, tau = 1 / (2 pi 10 Hz).
    spread = start.NOISE * np.sqrt(2.0 / (2.0 * np.pi * BANDWIDTH) / step)
    return age, day(rng).bias(age) + rng.normal(0.0, spread, len(age))
