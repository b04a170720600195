"""Filters of one gyro axis with the constants to choose: those of the node, of the papers, and trivial ones.

Each candidate is a function of its constants; `run` returns the rate after each sample.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.filters.rate_bias_kalman import KalmanGain, RateBiasKalman
from hubodo.sensors.filters.recursive_least_squares import RecursiveLeastSquares
from hubodo.sensors.filters.six_state import SixState

_RATE_GAIN_UNIT, _BIAS_GAIN_UNIT, _FORGETTING_UNIT = 1 << 20, 1 << 30, 1 << 20
_MAX_GAIN = (1 << 20) - 1
_FORGETTING_Q20_RANGE = (1 << 19, (1 << 20) - 1024)
"""Ranges of the settings of the node (firmware/README.md)."""
_DEFAULT_BIAS_GAIN_Q30 = 322
"""Default of the node: the bias follows the rate within hours."""
_TIMED_SAMPLES, _TIMED_ROUNDS = 2000, 3
_NO_WARMUP_S = 1e9
"""Time constant of a bias that does not change, s."""

Settings = dict[str, int]
"""Settings of the node that select a filter with its constants."""


@dataclass(frozen=True)
class StaticState:
    """Sample interval, static bias and noise, common to all filters.

    Attributes:
        dt: sample interval, s.
        bias: static bias, rad/s.
        noise: standard deviation of a sample at standstill, rad/s.
        averaged: samples averaged for the bias.
    """

    dt: float
    bias: float
    noise: float
    averaged: int


@dataclass(frozen=True)
class FilterCandidate:
    """A filter with its constants.

    Attributes:
        kind: raw, moving average, Kalman, RLS or six-state.
        constants: for people and JSON, with their unit in the name.
        run: function from samples (N,) rad/s to rates (N,) rad/s after each sample.
        new_update: function that returns a new filter, a function from one sample to one rate; None if the
            filter exists for whole records only.
        settings: the settings of the node, None where the node does not have the filter.
    """

    kind: str
    constants: dict[str, float]
    run: Callable[[Array], Array] = field(repr=False)
    settings: Settings | None = None
    new_update: Callable[[], Callable[[float], float]] | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Return kind and constants in one line."""
        if self.kind == "RLS":
            return f"RLS (λ = {self.constants['forgetting']:.4g})"
        return self.kind

    def seconds_per_sample(self, samples: Array) -> float:
        """Measure the run time on this computer, s per sample, sample by sample where the filter allows."""
        part = samples[:_TIMED_SAMPLES]
        values = part.tolist()
        elapsed = []
        for _ in range(_TIMED_ROUNDS):
            update = None if self.new_update is None else self.new_update()
            began = time.perf_counter()
            if update is None:
                self.run(part)
            else:
                for value in values:
                    update(value)
            elapsed.append(time.perf_counter() - began)
        return min(elapsed) / len(values)


def raw_candidate(initial: StaticState) -> FilterCandidate:
    """Return the candidate that only subtracts the static bias."""
    bias = initial.bias
    return FilterCandidate("raw", {}, lambda z: z - bias, {"filter_kind": 0}, lambda: lambda z: z - bias)


def moving_average_candidate(initial: StaticState, width: int) -> FilterCandidate:
    """Return the candidate that averages the last `width` samples, the baseline of every filter."""

    def run(z: Array) -> Array:
        sums = np.cumsum(np.concatenate([np.full(width, z[0]), z]) - initial.bias)
        averaged: Array = (sums[width:] - sums[:-width]) / width
        return averaged

    def new_update() -> Callable[[float], float]:
        recent: deque[float] = deque(maxlen=width)
        total = 0.0

        def update(z: float) -> float:
            nonlocal total
            total += z - (recent[0] if len(recent) == width else 0.0)
            recent.append(z)
            return total / len(recent) - initial.bias

        return update

    return FilterCandidate("moving average", {"width_samples": float(width)}, run, None, new_update)


def kalman_candidate(
    initial: StaticState, rate_gain: float, bias_gain: float | None = None
) -> FilterCandidate:
    """Return the constant-gain Kalman filter [rate, bias] with the gains that the node can hold.

    rate_gain, bias_gain: k1 g and k2 g per sample; without the latter, the default of the node.
    """
    rate_q20 = min(max(round(rate_gain * _RATE_GAIN_UNIT), 1), _MAX_GAIN)
    bias_q30 = _DEFAULT_BIAS_GAIN_Q30
    if bias_gain is not None:
        bias_q30 = min(max(round(bias_gain * _BIAS_GAIN_UNIT), 0), _MAX_GAIN)
    k1, k2 = rate_q20 / _RATE_GAIN_UNIT, bias_q30 / _BIAS_GAIN_UNIT
    total = min(k1 + k2, 1.0 - 1e-9)
    decay = -math.log1p(-total) / initial.dt
    gain = KalmanGain(decay * k1 / (k1 + k2), decay * k2 / (k1 + k2))

    def run(z: Array) -> Array:
        return (
            RateBiasKalman(gain, initial.dt, rate=float(z[0]) - initial.bias, bias=initial.bias).run(z).rate
        )

    settings = {"filter_kind": 1, "gain_rate_q20": rate_q20}
    if bias_gain is not None:
        settings["gain_bias_q30"] = bias_q30
    return FilterCandidate(
        "Kalman",
        {"rate_gain": k1, "bias_gain": k2},
        run,
        settings,
        lambda: RateBiasKalman(gain, initial.dt, bias=initial.bias).update,
    )


def recursive_least_squares_candidate(initial: StaticState, forgetting: float) -> FilterCandidate:
    """Return the RLS filter with a forgetting factor that the node can hold."""
    low, high = _FORGETTING_Q20_RANGE
    forgetting_q20 = min(max(round(forgetting * _FORGETTING_UNIT), low), high)
    quantised = forgetting_q20 / _FORGETTING_UNIT

    def run(z: Array) -> Array:
        return RecursiveLeastSquares(quantised, bias=initial.bias).run(z)

    return FilterCandidate(
        "RLS",
        {"forgetting": quantised},
        run,
        {"filter_kind": 2, "forgetting_q20": forgetting_q20},
        lambda: RecursiveLeastSquares(quantised, bias=initial.bias).update,
    )


def six_state_candidate(initial: StaticState, highest_derivative: float) -> FilterCandidate:
    """Return Barshan's six-state filter; its bias follows eq. 6 alone, without noise.

    highest_derivative: noise of the third derivative of the orientation, rad/s^3. With the printed noise a
    step of the rate enters the bias.
    """
    model = SixState(
        0.0, initial.bias, _NO_WARMUP_S, initial.noise, initial.dt, highest_derivative, bias_noise=0.0
    )

    def run(z: Array) -> Array:
        rate = model.run(z, np.array(initial.bias), initial.averaged)[1]
        return np.asarray(rate)

    return FilterCandidate("six-state", {"highest_derivative": highest_derivative}, run)
