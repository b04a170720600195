"""A gyro on a wheel that starts, rolls and stops, made without any code of hubodo.

The wheel rate is a chain of random speeds with limited acceleration, from rest to rest, as a driver with a
joystick makes it; the gyro adds a constant bias, a random walk of it, and white noise. For filters of one
axis; `rolling_node` adds the accelerometer in the turning frame for a wheel on a level road.
"""

from dataclasses import dataclass

import numpy as np

RADIUS = 0.165
"""m; of the Husky's wheels (data sheet: 330 mm)."""

GRAVITY = 9.80665


@dataclass(frozen=True)
class SpinDrive:
    """A gyro on a wheel.

    t: (N,) s. rate: the true wheel rate, z: the gyro, bias: what it adds, (N,) rad/s. rest: samples at the
    start in which the wheel stands. dt: s.
    """

    t: np.ndarray
    rate: np.ndarray
    z: np.ndarray
    bias: np.ndarray
    n_standstill: int
    dt: float


def wheel_rate(rng, duration, dt, *, top=1.0, acceleration=0.5, standstill_s=20.0):
    """(N,) rad/s: speeds of 0.3 ..

    `top` m/s held for 3 .. 8 s, changed at `acceleration` m/s^2, corners rounded over 0.2 s; every fifth leg
    is a stop. It stands for the first `rest` seconds.
    """
    wanted = [np.zeros(int(standstill_s / dt))]
    held, leg = 0.0, 0
    while held < duration - standstill_s:
        seconds = rng.uniform(3.0, 8.0)
        leg += 1
        speed = 0.0 if leg % 5 == 0 else rng.uniform(0.3, top)
        wanted.append(np.full(int(seconds / dt), speed))
        held += seconds
    target = np.concatenate(wanted)[: int(duration / dt)]
    speed, now, step = np.empty_like(target), 0.0, acceleration * dt
    for k, to in enumerate(target.tolist()):
        now += min(step, max(-step, to - now))
        speed[k] = now
    kernel = np.hanning(int(0.2 / dt) + 2)
    return np.convolve(speed, kernel / kernel.sum(), mode="same") / RADIUS


def sensed(rng, rate, dt, *, noise=9e-4, bias=0.02, walk=1e-5, standstill_s=20.0):
    """The gyro on that wheel.

    noise: rad/s per sample; bias: rad/s, 1 sigma of the constant; walk: rad/s per sqrt(s); rest: s at the
    start in which the wheel stands, a tenth of it held back for the first corner.
    """
    count = len(rate)
    drift = bias * rng.standard_normal() + np.cumsum(walk * np.sqrt(dt) * rng.standard_normal(count))
    z = rate + drift + noise * rng.standard_normal(count)
    return SpinDrive(np.arange(count) * dt, rate, z, drift, int(0.9 * standstill_s / dt), dt)


def rolling_node(rng, rate, dt, *, bias, noise=9e-4, vibration=0.2, arm=(0.01, 0.0), tilt=(0.0, 0.0)):
    """(N, 3) gyro and accel in node axes for a wheel that faces left: gravity turns as (cos, -sin).

    arm: m, lever arm of the sensing point; tilt: rad, of the axle in the node; vibration: m/s^2 a sample.
    """
    angle = rng.uniform(-np.pi, np.pi) + np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * dt)])
    change = np.gradient(rate, dt)
    forward = change * RADIUS
    c, s = np.cos(angle), np.sin(angle)
    fx = GRAVITY * c + forward * s - rate**2 * arm[0] - change * arm[1]
    fy = -GRAVITY * s + forward * c - rate**2 * arm[1] + change * arm[0]
    accel = np.column_stack([fx, fy, np.zeros_like(fx)])
    accel += vibration * rng.standard_normal(accel.shape)
    axle = np.array([tilt[1], -tilt[0], 1.0])
    gyro = rate[:, None] * axle / np.linalg.norm(axle) + bias
    return gyro + noise * rng.standard_normal(gyro.shape), accel
