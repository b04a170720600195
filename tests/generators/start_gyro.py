"""The START gyro of Barshan and Durrant-Whyte as a simulation, without any code of hubodo.

Figures of the paper: C1 0.300 deg/s (2.3 units of the converter), C2 -0.326 deg/s, T 63.6 min, noise 0.2
deg/s, 12 bit with 2048 = zero, 50 ms. All in deg/s and s here, as in the paper.
"""

import numpy as np

C1, C2, T, NOISE, DT = 0.300, -0.326, 63.6 * 60.0, 0.2, 0.05
STEP = 0.300 / 2.3
AVERAGED = 2000
RUN = 6000
"""Number of samples in five minutes."""

# Mean rate errors of the paper's three runs of five minutes (-70.8, +27.4, -84.7 deg): the offset of the day
# is chosen so that the simulated run drifts as much, because C2 alone has the wrong sign for the warm run.
DRIFTS_DEG = {"cold start": -70.8, "warmed up": 27.4, "random rates": -84.7}
AGES = {"cold start": 0.0, "warmed up": 8 * 3600.0, "random rates": 600.0}


def bias(t):
    """Return the bias in deg/s at t seconds since power-on, without the daily offset."""
    return C2 + C1 * (1.0 - np.exp(-t / T))


def digitise(rate):
    """Quantise a rate in deg/s by the 12-bit converter."""
    return np.clip(np.rint(rate / STEP), -2048, 2047) * STEP


def overnight(interval, duration, rng):
    """Return time and output at standstill for a night."""
    t = np.arange(0.0, duration, interval)
    return t, digitise(bias(t) + rng.normal(0.0, NOISE, len(t)))


def run(case, rng, offset=None):
    """Return true rate and output, (8000,) each, of 2,000 samples at rest and five minutes, and the age.

    offset: offset of the day, deg/s; None for the one that reproduces the paper's drift.
    """
    count = AVERAGED + RUN
    t = AGES[case] + np.arange(count) * DT
    if offset is None:
        offset = DRIFTS_DEG[case] / (RUN * DT) - bias(t[AVERAGED:]).mean()
    rate = np.zeros(count)
    if case == "random rates":
        rate[AVERAGED:] = np.repeat(rng.uniform(-25.0, 25.0, 10), RUN // 10)
    return rate, digitise(rate + bias(t) + offset + rng.normal(0.0, NOISE, count)), AGES[case]
