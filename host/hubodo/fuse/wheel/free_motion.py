"""Motion of a vehicle that nothing measures, in closed form.

Speed v and yaw rate r revert to zero as Ornstein-Uhlenbeck processes,

    dv = -v dt / T_v + V sqrt(2 / T_v) dw,    dr = -r dt / T_r + R sqrt(2 / T_r) dw',

and the displacement is the integral of v e^(iθ), θ' = r. Mean and covariance of these processes follow by
Gauss-Legendre quadrature (θ is Gaussian: E e^(iθ) = e^(im - s²/2) with mean m and variance s²). The cost is
the same for a second and a day, and the mean of a vehicle with unknown heading does not run away along a
tangent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.thresholds import HARD_ACCELERATION, MANOEUVRE_S
from hubodo.fuse.wheel.window import WINDOW_S

_SPEED_SIGMA, _SPEED_SIGMA_FACTOR, _SPEED_TIME_S = 2.0, 1.5, 16.0
"""Stationary sigma V of the speed: 2 m/s, a brisk walk, or 1.5 times the maximum speed so far. T_v: 16 s.

A walking vehicle is so expected to change its speed by 0.7 m/s within the first second. Estimated.
"""

_YAW_RATE_SIGMA = 0.35
"""Stationary sigma R of the yaw rate: 0.35 rad/s, a walker's bend, or `HARD_ACCELERATION` across the path at
V. T_r: `MANOEUVRE_S`. Estimated.
"""

_TRANSIENT_S = 60.0
"""s after which the start is forgotten and position variance grows linearly: many times T_v and T_r."""

UNIFORM_ANGLE_SIGMA = math.pi / math.sqrt(3.0)
"""rad, standard deviation of the uniform distribution over all directions."""

_LEGENDRE_NODES, _LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(24)
_QUADRATURE_NODES, _QUADRATURE_WEIGHTS = 0.5 * (_LEGENDRE_NODES + 1.0), 0.5 * _LEGENDRE_WEIGHTS


class MotionSigmas(NamedTuple):
    """Stationary standard deviations of speed, V in m/s, and yaw rate, R in rad/s, of a vehicle."""

    speed: float
    yaw_rate: float


def vehicle_motion_sigmas(max_speed: float) -> MotionSigmas:
    """Return the motion sigmas of a vehicle that has reached `max_speed`, m/s."""
    speed = max(_SPEED_SIGMA, _SPEED_SIGMA_FACTOR * max_speed)
    return MotionSigmas(speed, min(_YAW_RATE_SIGMA, HARD_ACCELERATION / speed))


def free_motion_variances(motion_sigmas: MotionSigmas) -> tuple[float, float]:
    """Return the growth of variance per window of an unmeasured speed, (m/s)², and yaw rate, (rad/s)²."""
    return (
        2.0 * motion_sigmas.speed**2 * WINDOW_S / _SPEED_TIME_S,
        2.0 * motion_sigmas.yaw_rate**2 * WINDOW_S / MANOEUVRE_S,
    )


class RateProcess(NamedTuple):
    """An Ornstein-Uhlenbeck process: stationary sigma, and time constant in s."""

    sigma: float
    time: float

    def covariance(self, t: Array) -> Array:
        """Return the covariance (N, N) at times t (N,), s, given the value at time 0."""
        share = np.exp(-t / self.time)
        return np.asarray(
            self.sigma**2 * (np.exp(-np.abs(t[:, None] - t) / self.time) - share[:, None] * share)
        )


def speed_process(motion_sigmas: MotionSigmas) -> RateProcess:
    """Return the process of the speed, m/s."""
    return RateProcess(motion_sigmas.speed, _SPEED_TIME_S)


def yaw_rate_process(motion_sigmas: MotionSigmas) -> RateProcess:
    """Return the process of the yaw rate, rad/s."""
    return RateProcess(motion_sigmas.yaw_rate, MANOEUVRE_S)


class FreeMotion(NamedTuple):
    """Motion of a vehicle during an outage, in axes of its heading at the start.

    Attributes
    ----------
    displacement : m, mean, forward + i left.
    by_speed, by_yaw_rate : derivatives of the displacement by speed and yaw rate at the start, s and m s/rad.
    heading_by_yaw_rate : s, derivative of the final heading by the yaw rate at the start.
    speed_decay, yaw_rate_decay : fractions of speed and yaw rate that remain at the end.
    noise : (5, 5), process noise of forward, left, heading, speed, yaw rate.
    """

    displacement: complex
    by_speed: complex
    by_yaw_rate: complex
    heading_by_yaw_rate: float
    speed_decay: float
    yaw_rate_decay: float
    noise: Array


def predict_free_motion(
    speed: float, yaw_rate: float, seconds: float, motion_sigmas: MotionSigmas
) -> FreeMotion:
    """Return the motion over `seconds` of a vehicle at `speed`, m/s, and `yaw_rate`, rad/s."""
    t = min(seconds, _TRANSIENT_S)
    s, weight = t * _QUADRATURE_NODES, t * _QUADRATURE_WEIGHTS
    speed_share, yaw_share = np.exp(-s / _SPEED_TIME_S), np.exp(-s / MANOEUVRE_S)
    final_speed_share, final_yaw_share = math.exp(-t / _SPEED_TIME_S), math.exp(-t / MANOEUVRE_S)
    mean_turn = MANOEUVRE_S * (1.0 - yaw_share)
    heading_covariance = _heading_covariance(s[:, None], s[None, :], motion_sigmas)
    heading_variance = heading_covariance.diagonal()
    mean_direction = np.exp(1j * yaw_rate * mean_turn - 0.5 * heading_variance)
    by_speed = complex(np.sum(weight * speed_share * mean_direction))
    by_turn = 1j * speed * weight * speed_share * mean_direction
    by_yaw_rate = complex(np.sum(by_turn * mean_turn))
    noise = np.zeros((5, 5))
    noise[:2, :2] = _path_covariance(s, weight, speed, mean_direction, heading_covariance, motion_sigmas)
    noise[:2, :2] += np.eye(2) * _asymptotic_growth(motion_sigmas) * (seconds - t)
    # Covariances of heading, speed and yaw rate at the end with the displacement.
    yaw_turn_covariance = (
        motion_sigmas.yaw_rate**2
        * MANOEUVRE_S
        * (final_yaw_share / yaw_share - 2.0 * final_yaw_share + final_yaw_share * yaw_share)
    )
    speed_covariance = motion_sigmas.speed**2 * final_speed_share * (1.0 / speed_share - speed_share)
    for index, covariance in enumerate(
        (
            np.sum(by_turn * _heading_covariance(s, np.full_like(s, t), motion_sigmas)),
            np.sum(weight * speed_covariance * mean_direction),
            np.sum(by_turn * yaw_turn_covariance),
        ),
        2,
    ):
        noise[:2, index] = noise[index, :2] = covariance.real, covariance.imag
    last = np.array([seconds])
    noise[2, 2] = float(_heading_covariance(last, last, motion_sigmas)[0])
    noise[3, 3] = motion_sigmas.speed**2 * (1.0 - final_speed_share**2)
    noise[4, 4] = motion_sigmas.yaw_rate**2 * (1.0 - final_yaw_share**2)
    noise[2, 4] = noise[4, 2] = motion_sigmas.yaw_rate**2 * MANOEUVRE_S * (1.0 - final_yaw_share) ** 2
    scale_to_uniform = min(1.0, UNIFORM_ANGLE_SIGMA / math.sqrt(noise[2, 2]))
    noise[2, :] *= scale_to_uniform
    noise[:, 2] *= scale_to_uniform
    return FreeMotion(
        speed * by_speed,
        by_speed,
        by_yaw_rate,
        MANOEUVRE_S * (1.0 - final_yaw_share),
        final_speed_share,
        final_yaw_share,
        noise,
    )


def _heading_covariance(s: Array, u: Array, motion_sigmas: MotionSigmas) -> Array:
    """Return the covariance of the headings at times s and u (s), rad².

    The heading is an integrated Ornstein-Uhlenbeck process that starts at zero.
    """
    scale = (motion_sigmas.yaw_rate * MANOEUVRE_S) ** 2
    decay_s, decay_u = np.exp(-s / MANOEUVRE_S), np.exp(-u / MANOEUVRE_S)
    decay_between = np.exp(-np.abs(s - u) / MANOEUVRE_S)
    headings_covariance: Array = scale * (
        2.0 * np.minimum(s, u) / MANOEUVRE_S
        - 2.0
        + 2.0 * (decay_s + decay_u)
        - decay_between
        - decay_s * decay_u
    )
    return headings_covariance


def _path_covariance(
    s: Array,
    weight: Array,
    speed: float,
    mean_direction: Array,
    heading_covariance: Array,
    motion_sigmas: MotionSigmas,
) -> Array:
    """Return the covariance of the displacement, (2, 2) m².

    It is E v_s v_u e^(iθ_s) e^(∓iθ_u), integrated over all pairs of times.
    """
    speed_share = np.exp(-s / _SPEED_TIME_S)
    mean_product = speed_share[:, None] * speed_share[None, :]
    speed_covariance = motion_sigmas.speed**2 * (
        np.exp(-np.abs(s[:, None] - s[None, :]) / _SPEED_TIME_S) - mean_product
    )
    speed_covariance += speed * speed * mean_product
    speed_covariance *= weight[:, None] * weight[None, :]
    mean = complex(np.sum(weight * speed * speed_share * mean_direction))
    along = mean_direction[:, None] * np.conj(mean_direction)[None, :] * np.exp(heading_covariance)
    across = mean_direction[:, None] * mean_direction[None, :] * np.exp(-heading_covariance)
    square, twice = complex(np.sum(speed_covariance * along)).real, complex(np.sum(speed_covariance * across))
    xx, yy = 0.5 * (square + twice.real), 0.5 * (square - twice.real)
    xy = 0.5 * twice.imag - mean.real * mean.imag
    return np.array([[xx - mean.real**2, xy], [xy, yy - mean.imag**2]])


def _asymptotic_growth(motion_sigmas: MotionSigmas) -> float:
    """Return the asymptotic growth of the position variance in each direction, m²/s.

    Green-Kubo: the integral of the autocorrelation of v e^(iθ).
    """
    s = _TRANSIENT_S * _QUADRATURE_NODES**2
    weight = 2.0 * _TRANSIENT_S * _QUADRATURE_NODES * _QUADRATURE_WEIGHTS
    ratio = s / MANOEUVRE_S
    mean_turn = (motion_sigmas.yaw_rate * MANOEUVRE_S) ** 2 * (ratio - 1.0 + np.exp(-ratio))
    return float(np.sum(weight * motion_sigmas.speed**2 * np.exp(-s / _SPEED_TIME_S - mean_turn)))
