"""The lowest point of a sum of squares and a smooth remainder, by damped steps of Gauss and Newton."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Parts = Callable[[FloatArray], tuple[FloatArray, FloatArray]]

_STEP = 1e-4
_ROUNDS, _TRIES = 40, 12
_ENOUGH = 1e-5


@dataclass(frozen=True)
class _Place:
    """A point x, its cost, half of the cost's gradient, and what residuals make of its second derivatives."""

    x: FloatArray
    cost: float
    gradient: FloatArray
    normal: FloatArray


def descend(parts: Parts, x: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, float]:
    """Where r(x)·r(x) + v(x) is smallest between low and high, (n,) each, from x on, and how small.

    parts: gives r, (M, m), and v, (M,), at M points x, (M, n); derivatives are taken by differences.
    """

    beside = np.vstack([np.zeros(len(x)), _STEP * np.eye(len(x))])

    def look(x: FloatArray) -> _Place:
        # All points in one call: a second one would take longer than the differences that a bad step wastes.
        residual, rest = parts(x + beside)
        jacobian, slope = (residual[1:] - residual[0]) / _STEP, (rest[1:] - rest[0]) / _STEP
        cost = float(residual[0] @ residual[0] + rest[0])
        return _Place(x, cost, jacobian @ residual[0] + 0.5 * slope, jacobian @ jacobian.T)

    now = look(np.minimum(np.maximum(x, low), high))
    damping = 1e-3
    for _ in range(_ROUNDS):
        stiff = np.diag(now.normal.diagonal() + 1e-3)
        before = now.cost
        for _ in range(_TRIES):
            step = np.linalg.solve(now.normal + damping * stiff, -now.gradient)
            step = np.minimum(np.maximum(step, -3.0), 3.0)
            there = look(np.minimum(np.maximum(now.x + step, low), high))
            if there.cost <= now.cost:
                now = there
                damping = max(damping / 10.0, 1e-9)
                break
            damping *= 10.0
        if before - now.cost < _ENOUGH:
            break
    return now.x, now.cost
