"""Robust losses: the cost and weight of a factor with a large residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hubodo.arrays import Array

_INITIAL_HUBER_LIMIT = 4.0
"""Squared sigma; from two sigma on, the loss for an initial guess grows like the norm."""


@dataclass(frozen=True, slots=True)
class Loss:
    """Cost and weight of a factor by its squared norm s, in units of its variance.

    quadratic: s / 2. huber: grows like the norm beyond s = limit (Huber 1964). bounded: quadratic up to s =
    limit, then flattening, and constant from s = 4 limit on, so that a fix 100 m off has no influence: the
    weight falls as (1 - u)^2 with u = (s - limit) / (3 limit), the redescending shape of Tukey's biweight
    beyond a quadratic centre.
    """

    kind: Literal["quadratic", "huber", "bounded"]
    limit: float = 0.0

    def weight(self, squared_norms: Array) -> Array:
        """Return the weight of each factor in iteratively reweighted least squares, (M,)."""
        if self.kind == "quadratic":
            return np.ones_like(squared_norms)
        if self.kind == "huber":
            return np.asarray(np.sqrt(self.limit / np.maximum(squared_norms, self.limit)))
        return np.asarray((1.0 - np.clip((squared_norms / self.limit - 1.0) / 3.0, 0.0, 1.0)) ** 2)

    def cost(self, squared_norms: Array) -> Array:
        """Return the cost of each factor, (M,); its derivative by s is half the weight."""
        inside = 0.5 * np.minimum(squared_norms, self.limit)
        if self.kind == "quadratic":
            return np.asarray(0.5 * squared_norms)
        if self.kind == "huber":
            return np.asarray(
                inside + np.sqrt(self.limit * np.maximum(squared_norms, self.limit)) - self.limit
            )
        remaining = 1.0 - np.clip((squared_norms / self.limit - 1.0) / 3.0, 0.0, 1.0)
        return np.asarray(inside + 0.5 * self.limit * (1.0 - remaining**3))

    def for_initial_guess(self) -> Loss:
        """Return a loss under which outliers keep their influence, for a poor initial guess."""
        return Loss("huber", _INITIAL_HUBER_LIMIT) if self.kind == "bounded" else self


QUADRATIC = Loss("quadratic")
