"""The lowest point of a sum of squares and a smooth remainder, by damped steps of Gauss and Newton."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Parts = Callable[[FloatArray], tuple[FloatArray, float]]

_STEP = 1e-4
_ROUNDS, _TRIES = 40, 12
_ENOUGH = 1e-5


def descend(parts: Parts, x: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, float]:
    """Where r(x)·r(x) + v(x) is smallest between low and high, (n,) each, from x on, and how small.

    parts: gives r, (m,), and v at x; derivatives are taken by differences.
    """
    x = np.clip(x, low, high)
    residual, rest = parts(x)
    cost = float(residual @ residual + rest)
    damping = 1e-3
    for _ in range(_ROUNDS):
        jacobian, slope = np.empty((len(residual), len(x))), np.empty(len(x))
        for k in range(len(x)):
            moved = x.copy()
            moved[k] += _STEP
            there, rest_there = parts(moved)
            jacobian[:, k], slope[k] = (there - residual) / _STEP, (rest_there - rest) / _STEP
        gradient = jacobian.T @ residual + 0.5 * slope
        normal = jacobian.T @ jacobian
        before = cost
        for _ in range(_TRIES):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-3), -gradient)
            there = np.clip(x + np.clip(step, -3.0, 3.0), low, high)
            new_residual, new_rest = parts(there)
            new = float(new_residual @ new_residual + new_rest)
            if new <= cost:
                x, residual, rest, cost = there, new_residual, new_rest, new
                damping = max(damping / 10.0, 1e-9)
                break
            damping *= 10.0
        if before - cost < _ENOUGH:
            break
    return x, cost
