"""Damped Gauss-Newton minimisation of a sum of squares plus a smooth remainder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array

CostFunction = Callable[[Array], tuple[Array, Array]]

_DIFFERENCE_STEP = 1e-4
_MAX_ITERATIONS, _MAX_DAMPING_TRIALS = 40, 12
_COST_TOLERANCE = 1e-5


@dataclass(frozen=True)
class _Iterate:
    """A point x with its cost, half the gradient of the cost, and half the approximate Hessian, J'J."""

    x: Array
    cost: float
    gradient: Array
    normal: Array


def minimise(evaluate: CostFunction, x: Array, low: Array, high: Array) -> tuple[Array, float]:
    """Return the minimiser and the minimum of r(x)·r(x) + v(x) within the bounds low and high, (n,) each.

    evaluate: returns the residuals r, (M, m), and the remainder v, (M,), at M points x, (M, n). x: (n,)
    start. Derivatives are forward differences.
    """

    offsets = np.vstack([np.zeros(len(x)), _DIFFERENCE_STEP * np.eye(len(x))])

    def linearise(x: Array) -> _Iterate:
        # One call evaluates all points, derivatives included: a second call after each accepted step would
        # take longer than the derivatives that a rejected step wastes.
        residual, remainder = evaluate(x + offsets)
        jacobian, slope = (
            (residual[1:] - residual[0]) / _DIFFERENCE_STEP,
            (remainder[1:] - remainder[0]) / _DIFFERENCE_STEP,
        )
        cost = float(residual[0] @ residual[0] + remainder[0])
        return _Iterate(x, cost, jacobian @ residual[0] + 0.5 * slope, jacobian @ jacobian.T)

    current = linearise(np.minimum(np.maximum(x, low), high))
    damping = 1e-3
    for _ in range(_MAX_ITERATIONS):
        scaling = np.diag(current.normal.diagonal() + 1e-3)
        previous_cost = current.cost
        for _ in range(_MAX_DAMPING_TRIALS):
            step = np.linalg.solve(current.normal + damping * scaling, -current.gradient)
            step = np.minimum(np.maximum(step, -3.0), 3.0)
            candidate = linearise(np.minimum(np.maximum(current.x + step, low), high))
            if candidate.cost <= current.cost:
                current = candidate
                damping = max(damping / 10.0, 1e-9)
                break
            damping *= 10.0
        if previous_cost - current.cost < _COST_TOLERANCE:
            break
    return current.x, current.cost
