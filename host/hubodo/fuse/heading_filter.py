"""Heading from one gyro whose warm-up is known: the rate drives the state, so no motion model can lag."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hubodo.effects.base import REFERENCE_CELSIUS
from hubodo.effects.warmup import WarmupModel

FloatArray = NDArray[np.float64]

DAY_TO_DAY_BIAS_SIGMA = math.radians(1.0)
"""rad/s, 1 sigma: how far a MEMS bias stands from its calibration after the next power-on."""

_FLICKER_TIME_RATIO, _MIN_FLICKER_TIME, _MAX_FLICKER_TIME = 5.0, 1.0, 1e5
"""Flicker is made of first-order Markov processes whose time constants are this ratio apart."""
_HEADING_INDEX, _OFFSET_INDEX = 0, 1


@dataclass(frozen=True)
class BiasNoise:
    """What a gyro's rate adds beside its warm-up, in the terms of IEEE 952.

    angle_random_walk: N, rad/√s. bias_instability: B, rad/s. rate_random_walk: K, rad/s/√s. offset: 1 sigma
    of the bias of the day, rad/s. warmup: 1 sigma of the parameters of the `WarmupModel` by name, SI; c2 is
    not among them, as the offset stands for it.
    """

    angle_random_walk: float
    bias_instability: float = 0.0
    rate_random_walk: float = 0.0
    offset: float = DAY_TO_DAY_BIAS_SIGMA
    warmup: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class HeadingState:
    """What is known after the last sample: heading, rad; bias, rad/s; 1 sigma of each.

    heading and bias have the shape of the rates that were handled.
    """

    heading: FloatArray
    bias: FloatArray
    sigma_heading: float
    sigma_bias: float


class HeadingFilter:
    """Kalman filter of the heading and of all by which the bias departs from the course of its warm-up.

    The bias is course(t) + h(t) . x. The course is eq. (1) of Barshan and Durrant-Whyte from power-on; x are
    the offset of the day, which walks, the errors of the warm-up's parameters, and flicker. While the sensor
    is known to be at rest a sample measures the bias, so a standstill long after the start still mends the
    heading before it. A moving sample is an input, not a measurement: nothing is assumed of the motion, and
    a step of the rate leaves no error. Flicker B is a sum of first-order Markov processes with variance
    B² ln(ratio) / pi each, whose time constants are evenly spaced in their logarithm.

    model: warm-up of this gyro. noise: of this gyro. age: s since power-on at the first sample. shape: of the
    rates, for many runs at once: the gains do not depend on the data.
    """

    def __init__(
        self, model: WarmupModel, noise: BiasNoise, *, age: float = 0.0, shape: tuple[int, ...] = ()
    ) -> None:
        self._model, self._noise, self._age = model, noise, age
        self._warmup_parameters = tuple(name for name, sigma in noise.warmup.items() if sigma > 0.0)
        count = math.ceil(math.log(_MAX_FLICKER_TIME / _MIN_FLICKER_TIME, _FLICKER_TIME_RATIO))
        constants = _MIN_FLICKER_TIME * _FLICKER_TIME_RATIO ** np.arange(
            count if noise.bias_instability else 0
        )
        self._decay: FloatArray = np.concatenate(
            [np.zeros(2 + len(self._warmup_parameters)), 1.0 / constants]
        )
        flicker = np.full(len(constants), noise.bias_instability**2 * math.log(_FLICKER_TIME_RATIO) / math.pi)
        warmup = [noise.warmup[name] ** 2 for name in self._warmup_parameters]
        self._steady_variance: FloatArray = np.concatenate([np.zeros(2 + len(warmup)), flicker])
        self._p = np.diag(np.concatenate([[0.0, noise.offset**2], warmup, flicker]))
        self._x = np.zeros((len(self._p), *shape))
        self._bias: FloatArray = np.zeros(shape)
        self._sigma_bias = noise.offset

    def update(
        self,
        rate: ArrayLike,
        dt: float,
        *,
        is_stationary: bool = False,
        temperature: float | None = None,
        sigma: float = 0.0,
    ) -> None:
        """Take the mean rate, rad/s, over the next dt, s.

        at_rest: the sensor is known not to turn. temperature: degrees C, if the model asks. sigma: rad/s, of
        this mean beside the gyro's noise, such as where samples are missing.
        """
        course, h = self._warmup_bias(self._age + 0.5 * dt, temperature)
        self._age += dt
        self._propagate_bias(dt)
        x, p = self._x, self._p
        carried = p @ h
        rest = np.asarray(rate, np.float64) - course - h @ x
        white = self._noise.angle_random_walk**2 / dt + sigma**2
        if is_stationary:
            variance = float(h @ carried) + white
            gain = carried / variance
            x += gain.reshape(-1, *([1] * rest.ndim)) * rest
            p -= gain[:, None] * carried
        else:
            x[_HEADING_INDEX] += rest * dt
            p[_HEADING_INDEX] -= dt * carried
            p[:, _HEADING_INDEX] -= dt * (p @ h)
            p[_HEADING_INDEX, _HEADING_INDEX] += white * dt**2
        self._bias = course + h @ x
        self._sigma_bias = math.sqrt(max(float(h @ p @ h), 0.0))

    def state(self) -> HeadingState:
        """What is known after the last sample."""
        sigma = math.sqrt(max(float(self._p[_HEADING_INDEX, _HEADING_INDEX]), 0.0))
        return HeadingState(self._x[_HEADING_INDEX].copy(), self._bias, sigma, self._sigma_bias)

    def _propagate_bias(self, dt: float) -> None:
        """The bias on to the next sample: the offset walks, flicker fades and is renewed."""
        self._p[_OFFSET_INDEX, _OFFSET_INDEX] += self._noise.rate_random_walk**2 * dt
        if self._noise.bias_instability:
            keep = np.exp(-self._decay * dt)
            self._x *= keep.reshape(-1, *([1] * (self._x.ndim - 1)))
            self._p *= keep[:, None] * keep
            self._p.flat[:: len(keep) + 1] += self._steady_variance * (1.0 - keep**2)

    def _warmup_bias(self, age: float, temperature: float | None) -> tuple[float, FloatArray]:
        """The warm-up's bias, rad/s, and what each state adds to it."""
        model = self._model
        grades = None if temperature is None else np.array([temperature])
        course = float(model.bias(np.array([age]), grades)[0])
        h = np.ones(len(self._p))
        h[_HEADING_INDEX] = 0.0
        pairs = {
            "": (model.c1, model.time_constant),
            "_second": (model.c1_second, model.time_constant_second),
        }
        for k, name in enumerate(self._warmup_parameters, 2):
            which = "_second" if name.endswith("_second") else ""
            c1, constant = pairs[which]
            left = math.exp(-age / constant)
            if name == f"c1{which}":
                h[k] = 1.0 - left
            elif name == f"time_constant{which}":
                h[k] = -c1 * age / constant**2 * left
            elif name == "temperature_coefficient":
                h[k] = 0.0 if temperature is None else temperature - REFERENCE_CELSIUS
            else:
                raise ValueError(f"no derivative with respect to {name!r}")
        return course, h
