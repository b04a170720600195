"""The one shape of what sensors outside the wheels tell: samples on their own times, to factors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, Protocol, TypeVar

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.factor import Factor
from hubodo.fuse.graph.steps import CutPath


class SensorSamples(Protocol):
    """N samples of one sensor, or one that just came."""

    @property
    def marks(self) -> Array:
        """Times at which a pose must stand, s; none for what is carried to the nearest."""
        ...

    def factors(self, cut: CutPath, config: GraphConfig) -> Factor | None:
        """The factors of one kind that the samples make of the poses at cut.state_t; None without any.

        At most one on each pose. Samples before the first pose or after the last are left out.
        """
        ...


Samples = TypeVar("Samples")


def gathered(samples: Sequence[Samples]) -> Samples:
    """Samples of one sensor put together. Each is a dataclass whose fields are all arrays."""
    kind: Any = type(samples[0])
    names = [item.name for item in fields(kind)]
    made: Samples = kind(*(np.concatenate([getattr(sample, name) for sample in samples]) for name in names))
    return made
