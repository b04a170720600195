"""Heading from one gyro axis with a warm-up model; gyro rates are inputs, so no motion model can lag."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.effects.warmup import WarmupModel

DAY_TO_DAY_BIAS_SIGMA = math.radians(1.0)
"""rad/s, 1 sigma: how far a MEMS gyro's bias is from its calibration after the next power-on."""

_FLICKER_TIME_RATIO, _MIN_FLICKER_TIME, _MAX_FLICKER_TIME = 5.0, 1.0, 1e5
"""Ratio, minimum and maximum (s) of the time constants of the Markov processes that form flicker noise."""
_HEADING_INDEX, _OFFSET_INDEX = 0, 1


@dataclass(frozen=True)
class BiasNoise:
    """Noise of a gyro rate in addition to its warm-up, in the terms of IEEE 952.

    Attributes
    ----------
    angle_random_walk : N, rad/√s.
    bias_instability : B, rad/s.
    rate_random_walk : K, rad/s/√s.
    offset : 1 sigma of the bias on one day, rad/s.
    warmup : 1 sigma of the `WarmupModel` parameters by name, SI; without c2, which `offset` covers.
    """

    angle_random_walk: float
    bias_instability: float = 0.0
    rate_random_walk: float = 0.0
    offset: float = DAY_TO_DAY_BIAS_SIGMA
    warmup: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class HeadingState:
    """Estimate after the last sample.

    Attributes
    ----------
    heading, bias : rad and rad/s, in the shape of the rates.
    sigma_heading, sigma_bias : 1 sigma of each.
    """

    heading: Array
    bias: Array
    sigma_heading: float
    sigma_bias: float


class HeadingFilter:
    """Kalman filter of the heading and of the deviation of the gyro bias from its warm-up model.

    The bias is w(t) + h(t) · x. w is eq. (1) of Barshan and Durrant-Whyte with t from power-on; x holds the
    offset of the day, a random walk, the errors of the warm-up parameters, and flicker noise; h holds the
    derivatives of the bias by x. A sample at standstill measures the bias, so a standstill long after the
    start still corrects the heading before it. A sample in motion is an input, not a measurement: nothing is
    assumed of the motion, and a step of the rate leaves no error. Flicker noise of bias instability B is a
    sum of first-order Markov processes with variance B² ln(ratio) / pi each, whose time constants are evenly
    spaced in their logarithm.

    Parameters
    ----------
    model : warm-up of this gyro.
    noise : noise of this gyro.
    age : s since power-on at the first sample.
    shape : shape of the rates, to process many runs at once; the gains do not depend on the data.
    """

    def __init__(
        self, model: WarmupModel, noise: BiasNoise, *, age: float = 0.0, shape: tuple[int, ...] = ()
    ) -> None:
        self._model, self._noise, self._age = model, noise, age
        self._warmup_parameters = tuple(name for name, sigma in noise.warmup.items() if sigma > 0.0)
        count = math.ceil(math.log(_MAX_FLICKER_TIME / _MIN_FLICKER_TIME, _FLICKER_TIME_RATIO))
        powers = np.arange(count if noise.bias_instability else 0)
        constants = _MIN_FLICKER_TIME * _FLICKER_TIME_RATIO**powers
        self._decay: Array = np.concatenate([np.zeros(2 + len(self._warmup_parameters)), 1.0 / constants])
        flicker = np.full(len(constants), noise.bias_instability**2 * math.log(_FLICKER_TIME_RATIO) / math.pi)
        warmup = [noise.warmup[name] ** 2 for name in self._warmup_parameters]
        self._steady_variance: Array = np.concatenate([np.zeros(2 + len(warmup)), flicker])
        self._p = np.diag(np.concatenate([[0.0, noise.offset**2], warmup, flicker]))
        self._x = np.zeros((len(self._p), *shape))
        self._bias: Array = np.zeros(shape)
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
        """Process the mean rate, rad/s, over the next dt, s.

        is_stationary: whether the sensor is known not to rotate. temperature: degrees C, if the model needs
        it. sigma: rad/s, error of this mean in addition to the gyro's noise, for example where samples are
        missing.
        """
        warmup_bias, h = self._warmup_bias(self._age + 0.5 * dt, temperature)
        self._age += dt
        self._propagate_bias(dt)
        x, p = self._x, self._p
        cross_covariance = p @ h
        residual = np.asarray(rate, np.float64) - warmup_bias - h @ x
        white = self._noise.angle_random_walk**2 / dt + sigma**2
        if is_stationary:
            variance = float(h @ cross_covariance) + white
            gain = cross_covariance / variance
            x += gain.reshape(-1, *([1] * residual.ndim)) * residual
            p -= gain[:, None] * cross_covariance
        else:
            x[_HEADING_INDEX] += residual * dt
            p[_HEADING_INDEX] -= dt * cross_covariance
            p[:, _HEADING_INDEX] -= dt * (p @ h)
            p[_HEADING_INDEX, _HEADING_INDEX] += white * dt**2
        self._bias = warmup_bias + h @ x
        self._sigma_bias = math.sqrt(max(float(h @ p @ h), 0.0))

    def state(self) -> HeadingState:
        """Return the estimate after the last sample."""
        sigma = math.sqrt(max(float(self._p[_HEADING_INDEX, _HEADING_INDEX]), 0.0))
        return HeadingState(self._x[_HEADING_INDEX].copy(), self._bias, sigma, self._sigma_bias)

    def _propagate_bias(self, dt: float) -> None:
        """Propagate offset (random walk) and flicker noise (Markov processes) to the next sample."""
        self._p[_OFFSET_INDEX, _OFFSET_INDEX] += self._noise.rate_random_walk**2 * dt
        if self._noise.bias_instability:
            decay_factor = np.exp(-self._decay * dt)
            self._x *= decay_factor.reshape(-1, *([1] * (self._x.ndim - 1)))
            self._p *= decay_factor[:, None] * decay_factor
            self._p.flat[:: len(decay_factor) + 1] += self._steady_variance * (1.0 - decay_factor**2)

    def _warmup_bias(self, age: float, temperature: float | None) -> tuple[float, Array]:
        """Return the bias of the warm-up model, rad/s, and its derivatives by the states."""
        model = self._model
        temperatures = None if temperature is None else np.array([temperature])
        warmup_bias = float(model.bias(np.array([age]), temperatures)[0])
        h = np.ones(len(self._p))
        h[_HEADING_INDEX] = 0.0
        exponentials = {
            "": (model.c1, model.time_constant),
            "_second": (model.c1_second, model.time_constant_second),
        }
        for k, name in enumerate(self._warmup_parameters, 2):
            suffix = "_second" if name.endswith("_second") else ""
            c1, time_constant = exponentials[suffix]
            remaining = math.exp(-age / time_constant)
            if name == f"c1{suffix}":
                h[k] = 1.0 - remaining
            elif name == f"time_constant{suffix}":
                h[k] = -c1 * age / time_constant**2 * remaining
            elif name == "temperature_coefficient":
                h[k] = 0.0 if temperature is None else temperature - REFERENCE_CELSIUS
            else:
                raise ValueError(f"no derivative with respect to {name!r}")
        return warmup_bias, h
