"""A node with three axes on an imperfect turntable: unequal stops, nudges, lean, vibration, drift.

From first principles: attitudes are products of matrices, Earth rate and gravity are vectors in east, north,
up. It shares nothing with the estimators.
"""

from dataclasses import dataclass, field

import numpy as np

from generators.noise import gyro_noise

EARTH_RATE = 7.292115e-5
DEG_H = np.pi / 180 / 3600


@dataclass
class Programme:
    """A programme of stops and turns.

    turns: angle of each turn, degrees, anticlockwise positive. stops: duration of each stop, s, one more than
    turns. rates: mean rate of each turn, deg/s. nudges: (s, degrees) of sudden small turns during a stop.
    """

    turns: list
    stops: list
    rates: list
    nudges: list = field(default_factory=list)

    def angle(self, t):
        """Return the angle at t, (N,) rad, and (stops, 3): start, end (s) and angle (rad) of each stop."""
        knots_t, knots_a, stood = [0.0], [0.0], []
        for stop, turn, rate in zip(self.stops, [*self.turns, None], [*self.rates, None], strict=True):
            start = knots_t[-1]
            knots_t.append(start + stop)
            knots_a.append(knots_a[-1])
            stood.append((start, start + stop, knots_a[-1]))
            if turn is not None:
                # The rate of a turn rises and falls as a raised cosine.
                length = 2 * abs(turn) / rate
                s = np.linspace(0, 1, 60)[1:]
                knots_a += list(knots_a[-1] + turn * (s - np.sin(2 * np.pi * s) / (2 * np.pi)))
                knots_t += list(knots_t[-1] + length * s)
        angle = np.radians(np.interp(t, knots_t, knots_a))
        for at, by in self.nudges:
            angle += np.radians(by) * np.clip((t - at) / 0.15, 0, 1)
        return angle, np.array(stood)

    @property
    def duration(self):
        return sum(self.stops) + sum(2 * abs(a) / r for a, r in zip(self.turns, self.rates, strict=True))


@dataclass
class Carousel:
    """A table that stands for `before` s, turns at `rate` deg/s for `turning` s, and stands for `after` s.

    It accelerates and decelerates within 2 s. ripple: relative ripple of the rate at 0.3 Hz.
    """

    before: float
    turning: float
    after: float
    rate: float
    ripple: float = 0.0

    def angle(self, t):
        """Return the table angle and the two stops as `Programme.angle` does."""
        fine = np.arange(0.0, self.duration + 0.02, 0.01)
        start, end = self.before, self.before + self.turning
        ramp = np.clip((fine - start) / 2, 0, 1) * np.clip((end - fine) / 2, 0, 1)
        rate = self.rate * ramp * (1 + self.ripple * np.sin(2 * np.pi * 0.3 * fine))
        turned = np.concatenate([[0.0], np.cumsum(0.005 * (rate[1:] + rate[:-1]))])
        spans = [(0.0, start, 0.0), (end, self.duration, np.radians(turned[-1]))]
        stood = np.array([span for span in spans if span[1] > span[0]]).reshape(-1, 3)
        return np.radians(np.interp(t, fine, turned)), stood

    @property
    def duration(self):
        return self.before + self.turning + self.after


def table_rows(programme, *, step=0.1, lag=0.0):
    """Return t, angle (rad) and moving of a table that writes a row every `step` s, `lag` s late."""
    t = np.arange(0.0, programme.duration, step)
    angle, stood = programme.angle(t)
    moving = ~((t[:, None] >= stood[:, 0] - 1e-9) & (t[:, None] < stood[:, 1] - 1e-9)).any(axis=1)
    return t + lag, angle, moving.astype(float)


def about(axis, angle):
    """Return rotation matrices (N, 3, 3) by angle (N,), rad, about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.zeros((len(angle), 3, 3))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rotation[:, axis, axis] = 1
    rotation[:, i, i] = rotation[:, j, j] = c
    rotation[:, j, i], rotation[:, i, j] = s, -s
    return rotation


def table_record(
    programme,
    rng,
    *,
    azimuth,
    latitude,
    hz=50.0,
    noise=None,
    scale=0.0,
    elevation=0.0,
    lean=(0.0, 0.0),
    vibration=0.0,
    bias=(0.01, -0.006, 0.008),
    cross_axis=0.0,
    kick=None,
):
    """Return t, gyro (N, 3), accel (N, 3) and the stops as in `Programme.angle`.

    azimuth: azimuth of x at table zero, rad clockwise from north. noise: n, b, k, r of each axis, see
    `gyro_noise`. scale: relative scale error of the gyro. elevation: angle of x above the horizon, rad. lean:
    inclination of the table's axis about east and north, rad. vibration: amplitude at 23.7 Hz on one axis
    after the other, rad/s. cross_axis: share of each rate that appears on the two other axes. kick: (start in
    s, duration in s, rad/s) of a blow on all axes.
    """
    dt = 1 / hz
    t = np.arange(0, programme.duration, dt)
    angle, stood = programme.angle(t)
    fine = np.arange(0, programme.duration + dt, dt / 4)
    spin = np.diff(programme.angle(fine)[0])[: 4 * len(t)].reshape(-1, 4).sum(axis=1) / dt
    # Each sample is the mean over its interval, as behind a low-pass; from table axes to east, north, up.
    base = about(0, np.array([lean[0]]))[0] @ about(1, np.array([lean[1]]))[0]
    zero = np.pi / 2 - azimuth
    world = base @ about(2, np.full(1, zero))[0] @ about(2, angle) @ about(1, np.full(1, -elevation))[0]
    earth = EARTH_RATE * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    turning = spin[:, None] * (base @ [0.0, 0.0, 1.0])
    gyro = np.einsum("nij,nj->ni", world.transpose(0, 2, 1), earth + turning)
    gyro = (1 + scale) * gyro + cross_axis * gyro[:, [1, 2, 0]] + cross_axis * gyro[:, [2, 0, 1]]
    gyro = gyro + np.array(bias)
    if kick is not None:
        gyro[(t >= kick[0]) & (t < kick[0] + kick[1])] += kick[2]
    accel = np.einsum("nij,j->ni", world.transpose(0, 2, 1), [0.0, 0.0, 9.80665])
    accel = accel + 0.02 * rng.standard_normal(accel.shape) + [0.05, -0.08, 0.1]
    for axis in range(3):
        gyro[:, axis] += gyro_noise(len(t), dt, rng, **(noise or {}))
        gyro[:, axis] += vibration * np.sin(2 * np.pi * 23.7 * t + axis)
    return t, gyro, accel, stood
