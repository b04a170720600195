"""Random drives and benches: motion of the vehicle and temperature of the nodes, from a seeded generator.

A drive is a blend of sections, each of another kind (jerk-limited legs, sums of sines, filtered noise), that
starts at rest, turns both ways and stops now and then. Speeds reach 3 to 6 m/s. No section is limited to the
band of a particular model; all have continuous accelerations, as the world's differences need.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from gap_matrix.world import STEP, Array, Motion, integral

DURATIONS = (60.0, 120.0, 240.0)
KINDS = ("drive", "bench", "turntable")
SIDEWAYS = 2.5  # m/s², what a turn at speed may pull
FASTEST_TURN = 1.2  # rad/s


@dataclass(frozen=True)
class Drive:
    """motion: 1 kHz. temperature: (N,) °C of the nodes along it. kind: one of KINDS."""

    motion: Motion
    temperature: Array
    kind: str

    @property
    def duration(self) -> float:
        return float(self.motion.t[-1])


def draw(rng: np.random.Generator, duration: float, kind: str = "drive") -> Drive:
    """Return a drive or bench of `duration` s. Raises ValueError if kind is not one of KINDS."""
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r}: one of {', '.join(KINDS)}")
    t = np.arange(round(duration / STEP) + 1) * STEP
    if kind == "drive":
        top = rng.uniform(3.0, 6.0)
        gate = _gate(rng, t, top)
        speed = gate * top * _blend(rng, t, [_speed_legs, _speed_sines, _speed_noise])
        turn = gate * _blend(rng, t, [_turn_legs, _turn_sines, _turn_noise])
        limit = SIDEWAYS / np.hypot(speed, SIDEWAYS / FASTEST_TURN)
        motion = Motion(speed, limit * np.tanh(turn))
        return Drive(motion, _weather(rng, t), kind)
    still = np.zeros(len(t))
    turn = _table(rng, t) if kind == "turntable" else still
    return Drive(Motion(still, turn), _warming(rng, t), kind)


def _ease(x: Array) -> Array:
    """Return a smooth step from 0 to 1 with two continuous derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0))


def _gate(rng, t, top):
    """Return a factor, 0 at the start, at the end and at a few stops, otherwise 1.

    The acceleration is 1.3 to 3.4 m/s² from `top` m/s.
    """
    ramps = iter(top * rng.uniform(0.55, 1.4, max(20, 4 + int(t[-1] / 17.0))))
    gate = _ease((t - rng.uniform(2.0, 5.0)) / next(ramps))
    gate = gate * _ease((t[-1] - rng.uniform(0.5, 2.5) - t) / next(ramps))
    for _ in range(max(1, int(t[-1] / rng.uniform(35.0, 70.0)))):
        start, rest, brake, go = (
            rng.uniform(12.0, t[-1] - 20.0),
            rng.uniform(1.0, 4.0),
            next(ramps),
            next(ramps),
        )
        gate = gate * (1.0 - _ease((t - start) / brake) * (1.0 - _ease((t - start - brake - rest) / go)))
    return gate


def _blend(rng, t, makers):
    """Return sections of 15 to 40 s, each of a random kind, with transitions of 2 s."""
    bounds = [0.0]
    while bounds[-1] < t[-1]:
        bounds.append(bounds[-1] + rng.uniform(15.0, 40.0))
    kinds = [*rng.permutation(len(makers)), *rng.integers(0, len(makers), len(bounds))]
    made = np.zeros(len(t))
    for k, (start, stop) in enumerate(pairwise(bounds)):
        here = slice(max(0, round((start - 1.0) / STEP)), min(len(t), round((stop + 1.0) / STEP)))
        weight = (_ease((t[here] - start + 1.0) / 2.0) if k else 1.0) - _ease((t[here] - stop + 1.0) / 2.0)
        made[here] += weight * makers[kinds[k]](rng, t[here] - t[here][0])
    return made


def _legs(rng, t, level, change, jerk):
    """Return constant levels joined by S-curves of at most `change()` per second and `jerk` per second²."""
    first = now_at = level()
    knots, pulls, now = [0.0], [0.0], 0.0
    while now < t[-1]:
        step = level() - now_at
        now_at += step
        most = max(min(change(), np.sqrt(abs(step) * jerk)), 1e-6)
        ramp, hold = most / jerk, max(abs(step) / most - most / jerk, 0.0)
        start = now + rng.uniform(0.3, 6.0)
        knots += [start, start + ramp, start + ramp + hold, start + 2.0 * ramp + hold]
        pulls += [0.0, np.sign(step) * most, np.sign(step) * most, 0.0]
        now = knots[-1]
    return first + integral(np.interp(t, knots, pulls), STEP)


def _sines(rng, t, low, high):
    """Return a sum of sines of unit variance, with log-uniform frequencies in Hz."""
    count = int(rng.integers(3, 9))
    frequency = np.exp(rng.uniform(np.log(low), np.log(high), count))
    size = rng.uniform(0.3, 1.0, count) / (1.0 + frequency / 0.3)
    size *= np.sqrt(2.0 / np.sum(size**2))
    return (size[:, None] * np.sin(2 * np.pi * frequency[:, None] * t + rng.uniform(0, 6.3, (count, 1)))).sum(
        0
    )


def _noise(rng, t, low, high):
    """Return Gaussian noise of unit variance through a zero-phase third-order low-pass, at 50 Hz."""
    coarse = np.arange(-20.0, t[-1] + 21.0, 0.02)
    corner = np.exp(rng.uniform(np.log(low), np.log(high)))
    made = sosfiltfilt(butter(3, corner, fs=50.0, output="sos"), rng.standard_normal(len(coarse)))
    return CubicSpline(coarse, made / np.std(made))(t)


def _speed_legs(rng, t):
    return _legs(
        rng,
        t,
        lambda: rng.uniform(0.0, 0.25) if rng.random() < 0.2 else rng.uniform(0.15, 1.0),
        lambda: rng.uniform(0.05, 0.7),
        rng.uniform(0.5, 3.0),
    )


def _speed_sines(rng, t):
    return 0.5 + 0.5 * np.tanh(rng.uniform(-0.3, 0.7) + 0.8 * _sines(rng, t, 0.02, 0.4))


def _speed_noise(rng, t):
    return 0.5 + 0.5 * np.tanh(rng.uniform(-0.3, 0.7) + 0.8 * _noise(rng, t, 0.05, 0.3))


def _turn_legs(rng, t):
    return _legs(
        rng,
        t,
        lambda: 0.0 if rng.random() < 0.35 else rng.uniform(-1.5, 1.5),
        lambda: rng.uniform(0.3, 2.0),
        rng.uniform(2.0, 8.0),
    )


def _turn_sines(rng, t):
    return rng.uniform(0.4, 1.0) * _sines(rng, t, 0.03, 0.8)


def _turn_noise(rng, t):
    return rng.uniform(0.4, 1.0) * _noise(rng, t, 0.08, 0.6)


def _weather(rng, t):
    """Return the temperature on a drive, °C: trend, slow waves and a change of place, range 3 to 12 °C."""
    u = t / t[-1]
    shape = rng.uniform(-1.0, 1.0) * u
    for _ in range(3):
        shape = shape + rng.uniform(0.1, 0.5) * np.sin(
            2 * np.pi * (rng.uniform(0.3, 2.5) * u + rng.uniform())
        )
    shape = shape + rng.uniform(-1.0, 1.0) * np.tanh((u - rng.uniform(0.2, 0.8)) / rng.uniform(0.05, 0.3))
    return rng.uniform(15.0, 32.0) + rng.uniform(3.0, 12.0) * (shape - shape[0]) / np.ptp(shape)


def _warming(rng, t):
    """Return the temperature on a bench, °C: a hyperbolic rise of 4 to 12 °C with a slow wave."""
    x = t / rng.uniform(30.0, 200.0)
    rise = x / (1.0 + x)
    wave = rng.uniform(0.05, 0.15) * np.sin(2 * np.pi * t / rng.uniform(40.0, 120.0))
    return rng.uniform(18.0, 27.0) + rng.uniform(4.0, 12.0) * (rise / rise[-1] + wave)


def _table(rng, t):
    """Return the rate of a table, rad/s, that turns and stops in both directions."""
    made, now = np.zeros(len(t)), rng.uniform(3.0, 6.0)
    while now < t[-1] - 8.0:
        length, ramp = rng.uniform(4.0, 15.0), rng.uniform(0.4, 1.5)
        rate = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 2.0)
        made += rate * (_ease((t - now) / ramp) - _ease((t - now - length) / ramp))
        now += length + ramp + rng.uniform(2.0, 6.0)
    return made
