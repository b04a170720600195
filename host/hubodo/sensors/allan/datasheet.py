"""What a data sheet promises of a sensor's noise, to be laid beside what was measured."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hubodo.sensors.allan.covariance import TERMS, design

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Datasheet:
    """Noise terms of one part in SI; terms: by name, Q, N, B, K, R as far as the sheet tells."""

    name: str
    terms: dict[str, float] = field(default_factory=dict)

    def deviation(self, tau: FloatArray) -> FloatArray:
        """(P,) Allan deviation at tau (s) of a sensor that is as the sheet says."""
        squares = np.array([self.terms.get(name, 0.0) ** 2 for name in TERMS])
        made: FloatArray = np.sqrt(design(tau) @ squares)
        return made
