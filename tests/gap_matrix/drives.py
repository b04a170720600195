"""Random drives and benches: motion of the vehicle and temperature of the nodes, from a seeded generator.

A drive blends sections of different kinds (jerk-limited legs, sums of sines, filtered noise). It starts at
rest, turns both ways and stops occasionally. Speeds reach 3 to 6 m/s. All accelerations are continuous, as
required by the numerical differentiation in `world.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from gap_matrix.world import STEP, Array, Motion, integrate

DURATIONS = (60.0, 120.0, 240.0)
KINDS = ("drive", "bench", "turntable")
MAX_LATERAL_ACCELERATION = 2.5  # m/s², in turns at speed
MAX_YAW_RATE = 1.2  # rad/s


@dataclass(frozen=True)
class Drive:
    """A drive or bench.

    motion: at 1 kHz
    temperature: (N,) °C of the nodes at the times of the motion
    kind: one of KINDS
    """

    motion: Motion
    temperature: Array
    kind: str

    @property
    def duration(self) -> float:
        """Return the duration in s."""
        return float(self.motion.t[-1])


def draw_drive(rng: np.random.Generator, duration: float, kind: str = "drive") -> Drive:
    """Return a drive or bench of `duration` s. Raises ValueError if kind is not one of KINDS."""
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r}: one of {', '.join(KINDS)}")
    t = np.arange(round(duration / STEP) + 1) * STEP
    if kind == "drive":
        max_speed = rng.uniform(3.0, 6.0)
        gate = _stop_gate(rng, t, max_speed)
        speed = gate * max_speed * _blend_sections(rng, t, [_speed_legs, _speed_sines, _speed_noise])
        yaw_rate = gate * _blend_sections(rng, t, [_turn_legs, _turn_sines, _turn_noise])
        limit = MAX_LATERAL_ACCELERATION / np.hypot(speed, MAX_LATERAL_ACCELERATION / MAX_YAW_RATE)
        motion = Motion(speed, limit * np.tanh(yaw_rate))
        return Drive(motion, _drive_temperature(rng, t), kind)
    zeros = np.zeros(len(t))
    yaw_rate = _turntable_rate(rng, t) if kind == "turntable" else zeros
    return Drive(Motion(zeros, yaw_rate), _bench_temperature(rng, t), kind)


def _ease(x: Array) -> Array:
    """Return a smooth step from 0 to 1 with two continuous derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0))


def _stop_gate(rng, t, max_speed):
    """Return a factor that is 0 at the start, at the end and at a few stops, otherwise 1.

    Ramps between 0 and 1 accelerate the vehicle to `max_speed` m/s by 1.3 to 3.4 m/s².
    """
    ramps = iter(max_speed * rng.uniform(0.55, 1.4, max(20, 4 + int(t[-1] / 17.0))))
    gate = _ease((t - rng.uniform(2.0, 5.0)) / next(ramps))
    gate = gate * _ease((t[-1] - rng.uniform(0.5, 2.5) - t) / next(ramps))
    for _ in range(max(1, int(t[-1] / rng.uniform(35.0, 70.0)))):
        start, standstill, brake_ramp, start_ramp = (
            rng.uniform(12.0, t[-1] - 20.0),
            rng.uniform(1.0, 4.0),
            next(ramps),
            next(ramps),
        )
        gate = gate * (
            1.0
            - _ease((t - start) / brake_ramp)
            * (1.0 - _ease((t - start - brake_ramp - standstill) / start_ramp))
        )
    return gate


def _blend_sections(rng, t, section_makers):
    """Return a blend of sections of 15 to 40 s, each of a random kind, with transitions of 2 s."""
    boundaries = [0.0]
    while boundaries[-1] < t[-1]:
        boundaries.append(boundaries[-1] + rng.uniform(15.0, 40.0))
    kinds = [*rng.permutation(len(section_makers)), *rng.integers(0, len(section_makers), len(boundaries))]
    blended = np.zeros(len(t))
    for k, (start, stop) in enumerate(pairwise(boundaries)):
        section = slice(max(0, round((start - 1.0) / STEP)), min(len(t), round((stop + 1.0) / STEP)))
        weight = (_ease((t[section] - start + 1.0) / 2.0) if k else 1.0) - _ease(
            (t[section] - stop + 1.0) / 2.0
        )
        blended[section] += weight * section_makers[kinds[k]](rng, t[section] - t[section][0])
    return blended


def _constant_legs(rng, t, draw_level, draw_max_rate, jerk):
    """Return constant levels joined by S-curves, with rates up to `draw_max_rate()` and jerk `jerk`."""
    first_level = present_level = draw_level()
    knot_times, rates, time = [0.0], [0.0], 0.0
    while time < t[-1]:
        step = draw_level() - present_level
        present_level += step
        max_rate = max(min(draw_max_rate(), np.sqrt(abs(step) * jerk)), 1e-6)
        ramp_duration, hold_duration = max_rate / jerk, max(abs(step) / max_rate - max_rate / jerk, 0.0)
        start = time + rng.uniform(0.3, 6.0)
        knot_times += [
            start,
            start + ramp_duration,
            start + ramp_duration + hold_duration,
            start + 2.0 * ramp_duration + hold_duration,
        ]
        rates += [0.0, np.sign(step) * max_rate, np.sign(step) * max_rate, 0.0]
        time = knot_times[-1]
    return first_level + integrate(np.interp(t, knot_times, rates), STEP)


def _sines(rng, t, low, high):
    """Return a sum of sines of unit variance, with log-uniform frequencies in Hz."""
    n_sines = int(rng.integers(3, 9))
    frequency = np.exp(rng.uniform(np.log(low), np.log(high), n_sines))
    amplitude = rng.uniform(0.3, 1.0, n_sines) / (1.0 + frequency / 0.3)
    amplitude *= np.sqrt(2.0 / np.sum(amplitude**2))
    return (
        amplitude[:, None] * np.sin(2 * np.pi * frequency[:, None] * t + rng.uniform(0, 6.3, (n_sines, 1)))
    ).sum(0)


def _noise(rng, t, low, high):
    """Return Gaussian noise of unit variance through a zero-phase third-order low-pass, at 50 Hz."""
    coarse_times = np.arange(-20.0, t[-1] + 21.0, 0.02)
    corner_frequency = np.exp(rng.uniform(np.log(low), np.log(high)))
    blended = sosfiltfilt(
        butter(3, corner_frequency, fs=50.0, output="sos"), rng.standard_normal(len(coarse_times))
    )
    return CubicSpline(coarse_times, blended / np.std(blended))(t)


def _speed_legs(rng, t):
    """Return a relative speed of constant legs, from 0 to 1."""
    return _constant_legs(
        rng,
        t,
        lambda: rng.uniform(0.0, 0.25) if rng.random() < 0.2 else rng.uniform(0.15, 1.0),
        lambda: rng.uniform(0.05, 0.7),
        rng.uniform(0.5, 3.0),
    )


def _speed_sines(rng, t):
    """Return a relative speed of sines, from 0 to 1."""
    return 0.5 + 0.5 * np.tanh(rng.uniform(-0.3, 0.7) + 0.8 * _sines(rng, t, 0.02, 0.4))


def _speed_noise(rng, t):
    """Return a relative speed of filtered noise, from 0 to 1."""
    return 0.5 + 0.5 * np.tanh(rng.uniform(-0.3, 0.7) + 0.8 * _noise(rng, t, 0.05, 0.3))


def _turn_legs(rng, t):
    """Return a yaw rate of constant legs, before it is limited."""
    return _constant_legs(
        rng,
        t,
        lambda: 0.0 if rng.random() < 0.35 else rng.uniform(-1.5, 1.5),
        lambda: rng.uniform(0.3, 2.0),
        rng.uniform(2.0, 8.0),
    )


def _turn_sines(rng, t):
    """Return a yaw rate of sines, before it is limited."""
    return rng.uniform(0.4, 1.0) * _sines(rng, t, 0.03, 0.8)


def _turn_noise(rng, t):
    """Return a yaw rate of filtered noise, before it is limited."""
    return rng.uniform(0.4, 1.0) * _noise(rng, t, 0.08, 0.6)


def _drive_temperature(rng, t):
    """Return the temperature on a drive, °C: trend, slow waves and a smooth step, range 3 to 12 °C."""
    u = t / t[-1]
    profile = rng.uniform(-1.0, 1.0) * u
    for _ in range(3):
        profile = profile + rng.uniform(0.1, 0.5) * np.sin(
            2 * np.pi * (rng.uniform(0.3, 2.5) * u + rng.uniform())
        )
    profile = profile + rng.uniform(-1.0, 1.0) * np.tanh((u - rng.uniform(0.2, 0.8)) / rng.uniform(0.05, 0.3))
    return rng.uniform(15.0, 32.0) + rng.uniform(3.0, 12.0) * (profile - profile[0]) / np.ptp(profile)


def _bench_temperature(rng, t):
    """Return the temperature on a bench, °C: a hyperbolic rise of 4 to 12 °C with a slow wave."""
    x = t / rng.uniform(30.0, 200.0)
    rise = x / (1.0 + x)
    wave = rng.uniform(0.05, 0.15) * np.sin(2 * np.pi * t / rng.uniform(40.0, 120.0))
    return rng.uniform(18.0, 27.0) + rng.uniform(4.0, 12.0) * (rise / rise[-1] + wave)


def _turntable_rate(rng, t):
    """Return the yaw rate of a turntable, rad/s, that turns and stops in both directions."""
    blended, time = np.zeros(len(t)), rng.uniform(3.0, 6.0)
    while time < t[-1] - 8.0:
        length, ramp_duration = rng.uniform(4.0, 15.0), rng.uniform(0.4, 1.5)
        rate = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 2.0)
        blended += rate * (_ease((t - time) / ramp_duration) - _ease((t - time - length) / ramp_duration))
        time += length + ramp_duration + rng.uniform(2.0, 6.0)
    return blended
