"""Choice of the bias estimator after a standstill, mean or a filter of Shah et al., by held-out error.

At standstill only the sum of rate and bias is observable, and the filters track that sum (their observability
matrix has rank 1). Each method therefore predicts the mean of the next segment. The bandwidth of a filter
is chosen in the first half of the record; the errors reported are those of the second half.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.filters.rate_bias_kalman import KalmanGain, RateBiasKalman
from hubodo.sensors.filters.recursive_least_squares import RecursiveLeastSquares

_MAX_COMPARED_SAMPLES = 120_000
"""Only the last samples of a record are used, because recursive least squares runs sample by sample."""
_COMPARED_SEGMENTS = 60
"""Segments of the record: half to choose the bandwidth, half to compare the methods."""
_KALMAN_TIME_CONSTANTS_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
_FORGETTING_FACTORS = (0.98, 0.92)
"""The two forgetting factors of the paper."""
_MIN_IMPROVEMENT_SIGMA = 2.0
"""Standard errors by which the squared error of a filter must be below that of the mean."""


@dataclass(frozen=True)
class BiasMethodChoice:
    """The bias estimator with the smallest held-out error.

    Attributes:
        chosen: "mean", "Kalman" or "RLS".
        why: reason for the choice, for the user.
        errors: rms held-out error by method, rad/s.
        segment_duration: duration of the predicted segment, s.
    """

    chosen: str
    why: str
    errors: dict[str, float]
    segment_duration: float


def choose_bias_method(values: Array, dt: float) -> BiasMethodChoice | None:
    """Return the method with the smallest held-out error over stationary samples (N,) rad/s, dt in s.

    A known warm-up must be subtracted beforehand. Returns None for too few samples.
    """
    values = values[-_MAX_COMPARED_SAMPLES:]
    width = len(values) // _COMPARED_SEGMENTS
    if width < 8:
        return None
    values = values[: width * _COMPARED_SEGMENTS]
    means = values.reshape(_COMPARED_SEGMENTS, width).mean(axis=1)
    targets = means[1:]
    ends = np.arange(1, _COMPARED_SEGMENTS) * width - 1
    selection = slice(0, _COMPARED_SEGMENTS // 2)
    comparison = slice(_COMPARED_SEGMENTS // 2, None)
    running_mean = np.cumsum(means) / np.arange(1, _COMPARED_SEGMENTS + 1)
    errors = {"mean": running_mean[:-1] - targets}

    def best(candidates: list[Array]) -> Array:
        return min(candidates, key=lambda error: float(np.mean(error[selection] ** 2)))

    errors["Kalman"] = best(
        [_run_kalman(values, dt, constant)[ends] - targets for constant in _KALMAN_TIME_CONSTANTS_S]
    )
    errors["RLS"] = best([_run_rls(values, width, factor)[ends] - targets for factor in _FORGETTING_FACTORS])
    rms = {name: float(np.sqrt(np.mean(error[comparison] ** 2))) for name, error in errors.items()}
    chosen = "mean"
    for name in ("Kalman", "RLS"):
        improvement = errors["mean"][comparison] ** 2 - errors[name][comparison] ** 2
        is_significant = float(improvement.mean()) > _MIN_IMPROVEMENT_SIGMA * float(
            improvement.std()
        ) / math.sqrt(len(improvement))
        if is_significant and rms[name] < rms[chosen]:
            chosen = name
    return BiasMethodChoice(chosen, _explain(chosen, width * dt), rms, width * dt)


def _run_kalman(values: Array, dt: float, constant: float) -> Array:
    """Return the (N,) estimates of rate + bias by eq. 9 to 12 of Shah et al., with a time constant in s."""
    candidates = RateBiasKalman(KalmanGain(0.5 / constant, 0.5 / constant), dt, bias=float(values[0])).run(
        values
    )
    return candidates.rate + candidates.bias


def _run_rls(values: Array, width: int, factor: float) -> Array:
    """Return the (N,) estimates of rate + bias by eq. 13 and 14; the first segment gives the static bias."""
    static = float(values[:width].mean())
    return RecursiveLeastSquares(factor, bias=static).run(values) + static


def _explain(chosen: str, segment_duration: float) -> str:
    reasons = {
        "mean": "no filter is significantly better, because they track noise",
        "Kalman": "the bias drifts slowly enough for a filter to track it",
        "RLS": "the bias drifts fast",
    }
    return f"to predict the bias of the next {segment_duration:.3g} s use the {chosen}: {reasons[chosen]}"
