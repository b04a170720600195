"""What every factor gives the solvers: whitened residuals with their derivatives, and what robust losses
weigh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array


class Linear(NamedTuple):
    """M factors of one kind, r rows each, about the present poses and constants, whitened.

    state: (M,) the pose each is tied to. residual: (M, r). by_state: (M, r, 3) derivatives by x, y, heading
    of that pose; by_next: the same by the pose after it, or None; by_constants: (M, r, 6).
    """

    state: NDArray[np.intp]
    residual: Array
    by_state: Array
    by_next: Array | None
    by_constants: Array


@dataclass(frozen=True, slots=True)
class Loss:
    """Cost and weight of a factor by its squared norm s, in units of its variance.

    quadratic: s / 2. huber: grows like the norm beyond s = limit (Huber 1964). bounded: the plain cost up
    to s = limit, then less and less, and no more from s = 4 limit on, so that a fix 100 m off pulls not at
    all: the weight falls as (1 - u)^2 for u = (s - limit) / (3 limit), the redescending shape of Tukey's
    biweight behind a plain middle.
    """

    kind: Literal["quadratic", "huber", "bounded"]
    limit: float = 0.0

    def weight(self, squares: Array) -> Array:
        """(M,) by which a row's information counts in iteratively reweighted least squares."""
        if self.kind == "quadratic":
            return np.ones_like(squares)
        if self.kind == "huber":
            return np.asarray(np.sqrt(self.limit / np.maximum(squares, self.limit)))
        return np.asarray((1.0 - np.clip((squares / self.limit - 1.0) / 3.0, 0.0, 1.0)) ** 2)

    def costs(self, squares: Array) -> Array:
        """(M,) cost of each; its derivative by s is half the weight."""
        inside = 0.5 * np.minimum(squares, self.limit)
        if self.kind == "quadratic":
            return np.asarray(0.5 * squares)
        if self.kind == "huber":
            return np.asarray(inside + np.sqrt(self.limit * np.maximum(squares, self.limit)) - self.limit)
        left = 1.0 - np.clip((squares / self.limit - 1.0) / 3.0, 0.0, 1.0)
        return np.asarray(inside + 0.5 * self.limit * (1.0 - left**3))


QUADRATIC = Loss("quadratic")
