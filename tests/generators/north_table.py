"""A gyro on a turntable, from first principles: attitude matrices, noise shaped in the frequency domain.

Shares nothing with the estimators: Earth rate is a vector in east, north, up, turned by a matrix into the
sensor; flicker comes from a 1/f spectrum and not from Markov processes.
"""

import itertools
from dataclasses import dataclass

import numpy as np

EARTH_RATE_DEG_H = 15.041067


@dataclass(frozen=True)
class Sensor:
    """A gyro with noise n in deg/sqrt(h), b in deg/h (flicker of IEEE 952) and k in deg/h/sqrt(h)."""

    n: float
    b: float
    k: float

    def error(self, count, dt, rng):
        """Return simulated errors of the rate, (count,) rad/s."""
        white = self.n / 60 * np.pi / 180 / np.sqrt(dt) * rng.standard_normal(count)
        size = 1 << int(np.ceil(np.log2(4 * count)))
        f = np.fft.rfftfreq(size, dt)
        amplitude = np.zeros(len(f))
        b = np.radians(self.b) / 3600
        # One-sided density 2 * B²/(2 pi f); each bin of width 1/(size dt) holds density / (size dt).
        amplitude[1:] = np.sqrt(b**2 / np.pi / f[1:] / (size * dt))
        spectrum = amplitude * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
        pink = np.fft.irfft(spectrum, size)[:count] * size / 2
        k = np.radians(self.k) / 3600 / 60
        walk = np.cumsum(rng.standard_normal(count)) * k * np.sqrt(dt)
        return white + pink + walk


def earth_in_sensor(azimuth, angle, latitude):
    """Return the Earth rate (N,) along a level axis on a table at `angle` (N,), rad.

    azimuth: azimuth of table zero, rad clockwise from north. In axes east, north, up, table zero points to
    (sin azimuth, cos azimuth, 0), and the table turns about up, anticlockwise seen from above.
    """
    earth = np.radians(EARTH_RATE_DEG_H) / 3600 * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    zero = np.array([np.sin(azimuth), np.cos(azimuth), 0.0])
    left = np.cross([0.0, 0.0, 1.0], zero)
    axis = np.cos(angle)[:, None] * zero + np.sin(angle)[:, None] * left
    return axis @ earth


@dataclass(frozen=True)
class Run:
    t: np.ndarray
    rate: np.ndarray
    vertical: np.ndarray
    table_t: np.ndarray
    table_angle: np.ndarray
    table_moving: np.ndarray


def maytag(error, dt, azimuth, latitude, angles, stop, turn, *, transient=0.0, rng=None):
    """Return a run with stops of `stop` s at each of `angles` and turns of `turn` s between them.

    error: gyro error, (N,) rad/s, of which the beginning is used. transient: additional rate caused by the
    turn, rad/s, which decays with a time constant of 0.15 s after the table has stopped.
    """
    t_table, a_table, moving = [0.0], [angles[0]], [0]
    now = 0.0
    for before, after in itertools.pairwise(angles):
        now += stop
        for s in np.linspace(0, 1, 9)[:-1]:
            t_table.append(now + s * turn)
            a_table.append(before + (after - before) * s)
            moving.append(1)
        now += turn
        t_table.append(now)
        a_table.append(after)
        moving.append(0)
    now += stop
    t_table.append(now)
    a_table.append(angles[-1])
    moving.append(0)
    t_table, a_table, moving = np.array(t_table), np.array(a_table), np.array(moving)
    count = round(now / dt)
    if count > len(error):
        raise ValueError(f"the programme takes {count} samples, the error has {len(error)}")
    t = np.arange(count) * dt
    angle = np.interp(t, t_table, a_table)
    spin = np.gradient(angle, dt)
    kernel = np.exp(-np.arange(int(2 / dt)) * dt / 0.15)
    vibration = (
        transient * np.convolve(np.sign(np.round(spin, 9)), kernel / kernel.sum())[:count]
        if transient
        else 0.0
    )
    rate = earth_in_sensor(azimuth, angle, latitude) + error[:count] + vibration
    vertical = spin.copy()
    if rng is not None:
        vertical = vertical + 1e-4 / np.sqrt(dt) * rng.standard_normal(count) + 0.003
    return Run(t, rate, vertical, t_table, a_table, moving.astype(bool))


def carousel(error, dt, azimuth, latitude, period, duration):
    """Return a run on a table that turns anticlockwise continuously, one turn per `period` s."""
    t = np.arange(round(duration / dt)) * dt
    angle = 2 * np.pi * t / period
    rate = earth_in_sensor(azimuth, angle, latitude) + error[: len(t)]
    rows = np.arange(0.0, duration + period / 36, period / 36)
    return Run(
        t,
        rate,
        np.full(len(t), 2 * np.pi / period),
        rows,
        2 * np.pi * rows / period,
        np.ones(len(rows), bool),
    )
