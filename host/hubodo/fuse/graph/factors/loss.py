"""What a factor costs that does not fit: robust losses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hubodo.arrays import Array

_INITIAL_HUBER_LIMIT = 4.0
"""Variances: beyond two sigma a loss for a first guess grows like the norm."""


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

    def cost(self, squares: Array) -> Array:
        """(M,) cost of each; its derivative by s is half the weight."""
        inside = 0.5 * np.minimum(squares, self.limit)
        if self.kind == "quadratic":
            return np.asarray(0.5 * squares)
        if self.kind == "huber":
            return np.asarray(inside + np.sqrt(self.limit * np.maximum(squares, self.limit)) - self.limit)
        left = 1.0 - np.clip((squares / self.limit - 1.0) / 3.0, 0.0, 1.0)
        return np.asarray(inside + 0.5 * self.limit * (1.0 - left**3))

    def for_initial_guess(self) -> Loss:
        """The loss under which what is far off still pulls, so that a poor guess is not kept."""
        return Loss("huber", _INITIAL_HUBER_LIMIT) if self.kind == "bounded" else self


QUADRATIC = Loss("quadratic")
