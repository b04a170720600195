"""Orientation from one gyro whose warm-up is known: the rate drives the state, so no motion model can lag."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hubodo.effects.warmup import BiasRecursion, WarmupModel


@dataclass(frozen=True)
class HeadingState:
    """heading: rad; bias: rad/s; sigma_heading, sigma_bias: 1 sigma; samples: handled so far."""

    heading: float
    bias: float
    sigma_heading: float
    sigma_bias: float
    samples: int


class WarmHeading:
    """Kalman filter with two states: heading, and the offset of the bias from the course of its warm-up.

    The bias is course(t) + offset: the course by the recursion of eq. (6) of Barshan and Durrant-Whyte from
    power-on, the offset because it differs from day to day. While the sensor is known to be at rest each
    sample measures the offset, so the mean over a standstill does not lag behind the drift within it. A
    moving sample is an input, not a measurement: nothing is assumed of the motion, and a step of the rate
    leaves no error.

    model: warm-up of this gyro. noise: 1 sigma of a rate sample, rad/s. dt: s. age: s since power-on at the
    first sample. offset_sigma: 1 sigma of the day-to-day offset, rad/s. rate_random_walk: K, rad/s per
    sqrt(s).
    """

    def __init__(
        self,
        model: WarmupModel,
        noise: float,
        dt: float,
        *,
        age: float = 0.0,
        offset_sigma: float = math.radians(1.0),
        rate_random_walk: float = 0.0,
    ) -> None:
        self._course = BiasRecursion(model, dt, age)
        self._noise, self._dt = noise, dt
        self._walk = rate_random_walk**2 * dt
        self._heading = self._offset = self._bias = 0.0
        self._heading_variance = self._cross = 0.0
        self._offset_variance = offset_sigma**2
        self._samples = 0

    def handle(self, rate: float, *, at_rest: bool = False, temperature: float | None = None) -> None:
        """Take one sample, rad/s; at_rest: the sensor is known not to turn; temperature: degrees C if the "
        "model asks."""
        course = self._course.value(temperature)
        self._course.advance()
        self._offset_variance += self._walk
        if at_rest:
            gain_heading = self._cross / (self._offset_variance + self._noise**2)
            gain_offset = self._offset_variance / (self._offset_variance + self._noise**2)
            innovation = rate - course - self._offset
            self._heading += gain_heading * innovation
            self._offset += gain_offset * innovation
            self._heading_variance -= gain_heading * self._cross
            self._cross *= 1.0 - gain_offset
            self._offset_variance *= 1.0 - gain_offset
        else:
            dt = self._dt
            self._heading += (rate - course - self._offset) * dt
            self._heading_variance += dt * (dt * (self._offset_variance + self._noise**2) - 2.0 * self._cross)
            self._cross -= dt * self._offset_variance
        self._bias = course + self._offset
        self._samples += 1

    def state(self) -> HeadingState:
        """What is known after the last sample."""
        return HeadingState(
            self._heading,
            self._bias,
            math.sqrt(max(self._heading_variance, 0.0)),
            math.sqrt(self._offset_variance),
            self._samples,
        )
