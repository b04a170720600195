"""Which bias to go on with after a rest: its mean, or that of a filter of Shah et al.; by held-out error.

At rest rate and bias are one sum, and the filters follow that sum (their observability matrix has rank 1). So
each way is asked for the mean of the next stretch, which it has not seen. What a filter needs to be told, how
fast to follow, is chosen in the first half of the record; the errors are those of the second half.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.sensors.warmup.rate_bias_kalman import Gain, RateBiasKalman
from hubodo.sensors.warmup.recursive_least_squares import RecursiveLeastSquares

FloatArray = NDArray[np.float64]

_MOST_SAMPLES = 120_000
"""The last of a record; recursive least squares takes them one by one."""
_STRETCHES = 60
"""Into which they are cut: half to choose, half to judge."""
_CONSTANTS_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
_FORGETTING = (0.98, 0.92)
"""The two of the paper."""
_SURE = 2.0
"""Standard errors by which a filter must be better than the mean."""


@dataclass(frozen=True)
class Choice:
    """chosen: "mean", "Kalman" or "RLS". why: in words. errors: by way, rms in rad/s. stretch: s."""

    chosen: str
    why: str
    errors: dict[str, float]
    stretch: float


def choose(values: FloatArray, dt: float) -> Choice | None:
    """The way with the smallest held-out error over samples (N,) rad/s at rest, dt s apart.

    What is known of the course, a warm-up, is taken off beforehand. None where they are too few.
    """
    values = values[-_MOST_SAMPLES:]
    width = len(values) // _STRETCHES
    if width < 8:
        return None
    values = values[: width * _STRETCHES]
    means = values.reshape(_STRETCHES, width).mean(axis=1)
    wanted = means[1:]
    ends = np.arange(1, _STRETCHES) * width - 1
    learn = slice(0, _STRETCHES // 2)
    judge = slice(_STRETCHES // 2, None)
    so_far = np.cumsum(means) / np.arange(1, _STRETCHES + 1)
    errors = {"mean": so_far[:-1] - wanted}

    def best(found: list[FloatArray]) -> FloatArray:
        return min(found, key=lambda error: float(np.mean(error[learn] ** 2)))

    errors["Kalman"] = best([_followed(values, dt, constant)[ends] - wanted for constant in _CONSTANTS_S])
    errors["RLS"] = best([_least_squares(values, width, factor)[ends] - wanted for factor in _FORGETTING])
    rms = {name: float(np.sqrt(np.mean(error[judge] ** 2))) for name, error in errors.items()}
    chosen = "mean"
    for name in ("Kalman", "RLS"):
        gained = errors["mean"][judge] ** 2 - errors[name][judge] ** 2
        sure = float(gained.mean()) > _SURE * float(gained.std()) / math.sqrt(len(gained))
        if sure and rms[name] < rms[chosen]:
            chosen = name
    return Choice(chosen, _why(chosen, rms, width * dt), rms, width * dt)


def _followed(values: FloatArray, dt: float, constant: float) -> FloatArray:
    """(N,) rate + bias by eq. 9 to 12 with a time constant in s; how it is split does not matter at rest."""
    found = RateBiasKalman(Gain(0.5 / constant, 0.5 / constant), dt, bias=float(values[0])).run(values)
    return found.rate + found.bias


def _least_squares(values: FloatArray, width: int, factor: float) -> FloatArray:
    """(N,) by eq. 13 and 14, after the first stretch has given the static bias."""
    static = float(values[:width].mean())
    return RecursiveLeastSquares(factor, bias=static).run(values) + static


def _why(chosen: str, rms: dict[str, float], stretch: float) -> str:
    told = ", ".join(f"{name} {math.degrees(value) * 3600.0:.3g}" for name, value in rms.items())
    because = {
        "mean": "no filter is surely better: what they follow is noise",
        "Kalman": "the bias wanders, and following it pays",
        "RLS": "the bias wanders fast",
    }
    errors = f"held-out error, deg/h: {told}"
    return f"to know the next {stretch:.3g} s take the {chosen}: {because[chosen]} ({errors})"
