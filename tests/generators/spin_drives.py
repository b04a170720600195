"""A gyro on a wheel that starts, rolls and stops, generated without any code of hubodo.

The wheel rate is a sequence of random speeds with limited acceleration, from rest to rest, as driven with a
joystick; the gyro adds a constant bias, its random walk, and white noise. For filters of one axis;
`rolling_node` adds the accelerometer in the rotating frame of a wheel on a level road.
"""

from dataclasses import dataclass

import numpy as np

RADIUS = 0.165
"""m; of the Husky's wheels (data sheet: 330 mm)."""

GRAVITY = 9.80665


@dataclass(frozen=True)
class SpinDrive:
    """A gyro on a wheel.

    t: (N,) s. rate: true wheel rate, z: reading of the gyro, bias: its bias, (N,) rad/s. rest: number of
    samples at standstill at the start. dt: sample interval, s.
    """

    t: np.ndarray
    rate: np.ndarray
    z: np.ndarray
    bias: np.ndarray
    n_standstill: int
    dt: float


def wheel_rate(rng, duration, dt, *, top=1.0, acceleration=0.5, standstill_s=20.0):
    """Return a wheel rate, (N,) rad/s: speeds from 0.3 to `top` m/s, each held for 3 to 8 s.

    Speeds change at `acceleration` m/s² with corners rounded over 0.2 s; every fifth leg is a stop. The wheel
    stands still for the first `rest` seconds.
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
    """Return the record of a gyro on that wheel.

    noise: rad/s per sample; bias: 1 sigma of the constant bias, rad/s; walk: rad/s per √s; rest: duration of
    the standstill at the start, s, of which the last tenth is left to the first rounded corner.
    """
    count = len(rate)
    drift = bias * rng.standard_normal() + np.cumsum(walk * np.sqrt(dt) * rng.standard_normal(count))
    z = rate + drift + noise * rng.standard_normal(count)
    return SpinDrive(np.arange(count) * dt, rate, z, drift, int(0.9 * standstill_s / dt), dt)


def rolling_node(rng, rate, dt, *, bias, noise=9e-4, vibration=0.2, arm=(0.01, 0.0), tilt=(0.0, 0.0)):
    """Return gyro and accelerometer, (N, 3) each, in axes of a node facing left: gravity is (cos, -sin).

    arm: lever arm of the sensing point, m; tilt: tilt of the axle in the node, rad; vibration: m/s² per
    sample.
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
