"""A gyro axis on a rate table, written out term by term; it shares nothing with the code under test."""

from dataclasses import dataclass

import numpy as np

STEPS_DEG_S = (0, 50, 100, 150, 200, 150, 100, 50, 0, -50, -100, -150, -200, -150, -100, -50, 0)


@dataclass(frozen=True)
class Axis:
    """Errors of the axis, rad/s: bias, its walk in 1 s, hysteresis, noise of a sample, step of the output.

    Relative: scale, and the difference of the scale factors of both directions. cubic: rad/s at 1 rad/s.
    """

    bias: float = 0.0
    walk: float = 0.0
    scale: float = 0.0
    asymmetry: float = 0.0
    cubic: float = 0.0
    hysteresis: float = 0.0
    noise: float = 1e-3
    step: float = 0.0

    def static(self, rate):
        """Return the reading at constant rates without bias and hysteresis."""
        side = np.where(rate > 0, 0.5, -0.5) * self.asymmetry
        return rate * (1 + self.scale + side) + self.cubic * rate**3


def turn_table(rng, axis, steps_deg_s=STEPS_DEG_S, seconds=20.0, rate_hz=50.0, acceleration=2.0, rounds=2):
    """Return times (N,), readings (N,), and the table as rows of (start of a rate, s; rate, rad/s)."""
    rates = np.radians([*steps_deg_s, *(list(steps_deg_s[1:]) * (rounds - 1))])
    t0, last, lines, table = 0.0, 0.0, [], []
    for rate in rates:
        ramp = abs(rate - last) / acceleration
        lines.append((t0, t0 + ramp, last, rate))
        table.append((t0 + ramp, rate))
        t0, last = t0 + ramp + seconds, rate
    t = np.arange(0.0, t0, 1 / rate_hz)
    knots = [(a, r0) for a, _, r0, _ in lines] + [(b, r1) for _, b, _, r1 in lines]
    knots.sort(key=lambda it: it[0])
    rate = np.interp(t, *np.array(knots).T)
    moving = np.sign(np.gradient(rate))
    side = np.zeros(len(t))
    for k in range(1, len(t)):
        side[k] = moving[k] if abs(moving[k]) > 0 and abs(rate[k] - rate[k - 1]) > 1e-9 else side[k - 1]
    drift = axis.bias + axis.walk * np.cumsum(rng.standard_normal(len(t))) / np.sqrt(rate_hz)
    reading = (
        drift + axis.static(rate) + axis.hysteresis / 2 * side + axis.noise * rng.standard_normal(len(t))
    )
    if axis.step:
        reading = axis.step * np.round(reading / axis.step)
    return t, reading, np.array(table)


def slip(rng, t, reading, table, count, largest=0.01):
    """Return the readings with `count` plateaus on which the table turned slower by up to `largest`."""
    reading, ends = reading.copy(), np.append(table[1:, 0], t[-1] + 1.0)
    for k in rng.choice(np.flatnonzero(table[:, 1]), count, replace=False):
        rows = (t >= table[k, 0]) & (t < ends[k])
        reading[rows] -= table[k, 1] * largest * rng.uniform(0.3, 1.0)
    return reading
