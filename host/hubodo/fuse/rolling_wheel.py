"""Distance rolled by one wheel from the rate about its axle, with the gyro bias estimated at standstill."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.earth import STANDARD_GRAVITY
from hubodo.vehicle import Facing, Side, facing_sign

_MAX_KNOTS = 1 << 17
"""Points kept of a wheel whose partner sends nothing: twenty minutes at 104 Hz, some 20 MB."""

_HALF_BLOCK_NS = 250_000_000
"""ns; two of them are tested for standstill together. Estimated."""

_BIAS_RANDOM_WALK = 2e-5
"""rad/s per √s: a bias drifts by 0.07 deg/s in an hour of steady temperature. Estimated."""

_MAX_STANDSTILL_SPREAD, _MAX_STANDSTILL_RATE = 0.02, 0.35
"""rad/s at standstill: spread, far above sensor noise; mean, twice the zero-rate level of a bad part."""

_MAX_STANDSTILL_TURN = 0.005
"""rad by which gravity may turn between half blocks: 20 mrad/s, 3 mm/s at a wheel of 0.15 m."""

_MIN_BIAS_SIGMA = 2e-4
"""rad/s, error of a mean over a standstill however long: bias instability, 40 deg/h. Estimated."""

_MIN_BLOCK_SAMPLES = 10
"""Samples; a block with fewer is never taken as a standstill."""


@dataclass(frozen=True, slots=True)
class WheelSpec:
    """A wheel and its node.

    Attributes
    ----------
    radius : m.
    facing : side to which the node's z axis points.
    gyro_bias : rad/s, initial bias of the z axis.
    gyro_bias_sigma : rad/s, 1 sigma; by default a third of the LSM6DS33's zero-rate level of 10 deg/s.
    """

    radius: float
    facing: Facing
    gyro_bias: float = 0.0
    gyro_bias_sigma: float = 0.05


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Noise and constant errors that make up the covariance, all 1 sigma.

    Attributes
    ----------
    gyro : rad/s per sample, of an MPU-6050 at its largest bandwidth.
    road, lateral : m per √m rolled, along and across the path; assumed for tyres on ordinary ground.
    speed_walk : m/s per √s, random walk of the speed where samples are missing; assumed.
    radius, radius_each, track : constant errors as fractions: radius common to both wheels, radius of each
        wheel, track width.
    """

    gyro: float = 0.004
    road: float = 0.002
    lateral: float = 0.001
    speed_walk: float = 1.0
    radius: float = 0.005
    radius_each: float = 0.001
    track: float = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class WheelSamples:
    """Consecutive samples of the node on one wheel, in node axes.

    Attributes
    ----------
    side : side of the wheel.
    t_ns : (N,) ns on the host's clock.
    gyro : (N, 3) rad/s.
    accel : (N, 3) m/s², specific force.
    """

    side: Side
    t_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]


class RollingWheel:
    """Distance rolled by one wheel, as knots (time, distance, variance) between which it is linear."""

    def __init__(self, spec: WheelSpec, noise: OdometryNoise, estimate_bias: bool) -> None:
        self.knots: deque[tuple[int, float, float]] = deque()
        self.bias = spec.gyro_bias
        self.bias_sigma = spec.gyro_bias_sigma
        self.is_initialised = not estimate_bias  # whether a first block has been tested for standstill
        self.newest_t_ns = 0
        self._sign = facing_sign(spec.facing)
        self._radius = spec.radius
        self._noise = noise
        self._rate = 0.0
        self._standstill = StandstillBlocks() if estimate_bias else None

    def add_samples(self, samples: WheelSamples) -> int:
        """Integrate samples and return how many were late."""
        late = 0
        noise, radius = self._noise, self._radius
        gyro_variance, road, walk = (radius * noise.gyro) ** 2, noise.road**2, noise.speed_walk**2 / 12
        rows = zip(
            samples.t_ns.tolist(),
            samples.gyro[:, 2].tolist(),
            samples.accel[:, 0].tolist(),
            samples.accel[:, 1].tolist(),
            strict=True,
        )
        for t_ns, rate, ax, ay in rows:
            if self.knots:
                before, distance, variance = self.knots[-1]
                if t_ns <= before:
                    late += 1
                    continue
                dt = (t_ns - before) * 1e-9
                ds = radius * self._sign * (0.5 * (self._rate + rate) - self.bias) * dt
                variance += gyro_variance * dt * dt + road * abs(ds) + walk * dt**3
                self.knots.append((t_ns, distance + ds, variance))
            else:
                self.knots.append((t_ns, 0.0, 0.0))
            self._rate, self.newest_t_ns = rate, t_ns
            if self._standstill is not None and self._standstill.add_sample(t_ns, rate, ax, ay):
                self._update_bias(self._standstill)
        if len(self.knots) > _MAX_KNOTS:
            # If the other wheel is missing for minutes, no track can be computed for that time anyway.
            self.knots = deque([*list(self.knots)[:-1:2], self.knots[-1]])
        return late

    def distance_at(self, t_ns: int) -> tuple[float, float]:
        """Return distance, m, and variance at a time between the oldest and the newest knot.

        Older knots are dropped.
        """
        knots = self.knots
        while len(knots) > 1 and knots[1][0] <= t_ns:
            knots.popleft()
        t0, s0, v0 = knots[0]
        if len(knots) == 1 or t_ns == t0:
            return s0, v0
        t1, s1, v1 = knots[1]
        share = (t_ns - t0) / (t1 - t0)
        return s0 + share * (s1 - s0), v0 + share * (v1 - v0)

    def _update_bias(self, block: StandstillBlocks) -> None:
        """Update the gyro bias with the mean rate of a block that was tested for standstill."""
        if block.is_stationary:
            variance = self.bias_sigma**2
            gain = variance / (variance + block.variance)
            change = gain * (block.mean - self.bias)
            self.bias += change
            self.bias_sigma = math.sqrt(
                (1 - gain) * variance + _BIAS_RANDOM_WALK**2 * 2 * _HALF_BLOCK_NS * 1e-9
            )
            if not self.is_initialised:
                start = self.knots[0][0]
                slope = self._radius * self._sign * change * 1e-9
                self.knots = deque((t, s - slope * (t - start), v) for t, s, v in self.knots)
        self.is_initialised = True


class StandstillBlocks:
    """Blocks of half a second, stationary where the gyro is steady and gravity does not turn."""

    def __init__(self) -> None:
        self.is_stationary = False
        self.mean = self.variance = 0.0
        self._end_ns: int | None = None
        self._half_block = [0.0] * 5
        self._previous_half_block: list[float] | None = None

    def add_sample(self, t_ns: int, rate: float, ax: float, ay: float) -> bool:
        """Add one sample and return True when it has completed the test of a block."""
        judged = False
        if self._end_ns is None:
            self._end_ns = t_ns + _HALF_BLOCK_NS
        elif t_ns >= self._end_ns:
            self._end_ns = t_ns + _HALF_BLOCK_NS
            judged = self._previous_half_block is not None
            if self._previous_half_block is not None:
                self._evaluate_block(self._previous_half_block, self._half_block)
                self._previous_half_block = None
            else:
                self._previous_half_block = self._half_block
            self._half_block = [0.0] * 5
        half = self._half_block
        half[0] += 1
        half[1] += rate
        half[2] += rate * rate
        half[3] += ax
        half[4] += ay
        return judged

    def _evaluate_block(self, first_half: list[float], second_half: list[float]) -> None:
        n = first_half[0] + second_half[0]
        self.mean = (first_half[1] + second_half[1]) / n
        spread = max((first_half[2] + second_half[2]) / n - self.mean**2, 0.0)
        turn = (
            math.hypot(
                first_half[3] / first_half[0] - second_half[3] / second_half[0],
                first_half[4] / first_half[0] - second_half[4] / second_half[0],
            )
            / STANDARD_GRAVITY
        )
        steady = (
            spread < _MAX_STANDSTILL_SPREAD**2
            and abs(self.mean) < _MAX_STANDSTILL_RATE
            and turn < _MAX_STANDSTILL_TURN
        )
        self.is_stationary = steady and n >= _MIN_BLOCK_SAMPLES
        self.variance = spread / n + _MIN_BIAS_SIGMA**2
