"""Propagation of states and covariance over an outage of all wheels in one step."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import RATE_BEYOND_RANGE, WHEEL_ANGLE
from hubodo.fuse.wheel.free_motion import UNIFORM_ANGLE_SIGMA, MotionSigmas, predict_free_motion
from hubodo.fuse.wheel.records import POSE_ENTRIES
from hubodo.fuse.wheel.state_vector import InitialState


class OutageModel:
    """Propagation of states and covariance over an outage of any length in one step."""

    def __init__(self, config: WheelConfig, initial: InitialState) -> None:
        columns = initial.columns
        self._at = columns.vehicle
        self._walk = initial.walk_variances.copy()
        self._max_variance = np.full(columns.size, np.inf)
        self._gauss_markov: list[tuple[int, float, float]] = []
        self._wheels = [(at[WHEEL_ANGLE], at[RATE_BEYOND_RANGE]) for at in columns.wheels]
        for at in columns.wheels:
            for entry, index in at.items():
                # The variance of a random walk is bounded by its prior however long the outage is.
                self._max_variance[index] = max(entry.prior**2, initial.p[index, index])
        for entry, index in columns.vehicle.items():
            if math.isfinite(entry.correlation_time):
                self._gauss_markov.append((index, entry.correlation_time, initial.p[index, index]))

    def advance(
        self, x: list[float], p: Array, seconds: float, motion_sigmas: MotionSigmas, is_stationary: bool
    ) -> tuple[Array, float]:
        """Propagate x and p in place to the end of an outage of `seconds`.

        is_stationary: True if the vehicle stood still before it. Return the transition (n, n) and the
        heading variance added, rad².
        """
        at = [self._at[entry] for entry in POSE_ENTRIES]
        if is_stationary:
            x[at[3]] = x[at[4]] = 0.0
        motion = predict_free_motion(x[at[3]], x[at[4]], seconds, motion_sigmas)
        direction = complex(math.cos(x[at[2]]), math.sin(x[at[2]]))
        transition = np.eye(len(x))
        for column, change in (
            (at[2], 1j * motion.displacement * direction),
            (at[3], motion.by_speed * direction),
            (at[4], motion.by_yaw_rate * direction),
        ):
            transition[at[0], column], transition[at[1], column] = change.real, change.imag
        transition[at[2], at[4]] = motion.heading_by_yaw_rate
        transition[at[3], at[3]], transition[at[4], at[4]] = motion.speed_decay, motion.yaw_rate_decay
        for index, correlation_time_s, _ in self._gauss_markov:
            transition[index, index] = math.exp(-seconds / correlation_time_s)
        for angle, excess in self._wheels:
            transition[angle, angle] = transition[excess, excess] = 0.0
        displacement = motion.displacement * direction
        x[at[2]] += motion.heading_by_yaw_rate * x[at[4]]
        x[at[0]] += displacement.real
        x[at[1]] += displacement.imag
        x[at[3]] *= motion.speed_decay
        x[at[4]] *= motion.yaw_rate_decay
        for index, _, _ in self._gauss_markov:
            x[index] *= transition[index, index]
        for angle, excess in self._wheels:
            x[angle] = x[excess] = 0.0
        rotation = np.eye(5)
        rotation[:2, :2] = [[direction.real, -direction.imag], [direction.imag, direction.real]]
        noise = rotation @ motion.noise @ rotation.T
        if is_stationary:
            # Later windows may show that the vehicle did not turn: this variance is uncorrelated with all
            # states, so that it can be removed again.
            noise = np.diag(noise.diagonal())
        self.propagate_covariance(p, transition, seconds)
        p[np.ix_(at, at)] += noise
        return transition, float(noise[2, 2])

    def bridge(
        self, x: list[float], p: Array, seconds: float, after: list[float], transition: Array, noise: Array
    ) -> None:
        """Propagate x and p in place over an outage whose motion `outage_bridge.py` has determined.

        after: states after it. transition (n, n), which this completes in place, and noise (n, n) as in
        `outage_bridge.py`.
        """
        x[:] = after
        for index, correlation_time_s, _ in self._gauss_markov:
            transition[index, index] = math.exp(-seconds / correlation_time_s)
            x[index] *= transition[index, index]
        for _, excess in self._wheels:
            transition[excess, excess] = x[excess] = 0.0
        self.propagate_covariance(p, transition, seconds)
        for angle, _ in self._wheels:
            p[angle, angle] = 0.0
        p += noise

    def propagate_covariance(self, p: Array, transition: Array, seconds: float) -> None:
        """Propagate the covariance of all states but the pose over `seconds`, in place."""
        p[:] = transition @ p @ transition.T
        diagonal = p.ravel()[:: len(p) + 1]
        room = np.maximum(self._max_variance - diagonal, 0.0)
        diagonal += np.minimum(self._walk * seconds, room)
        for index, correlation_time_s, stationary_variance in self._gauss_markov:
            diagonal[index] += stationary_variance * (1.0 - math.exp(-2.0 * seconds / correlation_time_s))
        for angle, _ in self._wheels:
            diagonal[angle] = UNIFORM_ANGLE_SIGMA**2
