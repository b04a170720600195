"""The one shape of all factors: residuals with derivatives, a loss, and which poses they are tied to."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.loss import QUADRATIC, Loss

if TYPE_CHECKING:  # both are built from factors
    from hubodo.fuse.graph.config import GraphConfig
    from hubodo.fuse.graph.odometry_steps import SegmentedOdometry

Flags = NDArray[np.bool_]

_MAX_RUN_GAP = 3
"""Numbers by which two flags may differ and still be of one stretch: two sound fixes in a jump are chance."""


class LinearisedFactors(NamedTuple):
    """M factors of one kind, r rows each, about the present poses and constants, whitened.

    state: (M,) the pose each is tied to. residual: (M, r). by_state: (M, r, 3) derivatives by x, y, heading
    of that pose; by_next: the same by the pose after it, or None; by_constants: (M, r, COUNT).
    """

    pose_index: NDArray[np.intp]
    residual: Array
    pose_jacobian: Array
    next_pose_jacobian: Array | None
    constants_jacobian: Array

    @property
    def squared_norms(self) -> Array:
        """(M,) squared norm of each factor, in units of its variance."""
        return np.asarray(np.einsum("ij,ij->i", self.residual, self.residual))


@dataclass(frozen=True, eq=False)
class FactorGroup(ABC):
    """M factors of one kind.

    state: (M,) numbers of their poses, increasing: at most one of a kind on a pose. Every array of a kind
    counts factors along its first axis, so that parts of a graph are cut out and put together without
    knowing the kind.
    """

    pose_index: NDArray[np.intp]
    loss: Loss = field(default=QUADRATIC, kw_only=True)

    @abstractmethod
    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """About poses (n, 3) and constants (COUNT,)."""

    def describe_outliers(self, out: Flags, norm: Array, pose_t: Array) -> list[str]:
        """One line for each thing to say of a solution.

        out: (M,) which count little; norm: (M,) in sigma; pose_t: (n,) s of all poses.
        """
        return []

    def select_poses(self, begin: int, end: int) -> Self:
        """The factors tied to poses begin to end - 1; the poses are numbered from `begin` on."""
        first, last = np.searchsorted(self.pose_index, [begin, end])
        return self._slice_factors(int(first), int(last), begin)

    def select_factor(self, i: int) -> Self:
        """Factor i alone, on pose 0."""
        return self._slice_factors(i, i + 1, int(self.pose_index[i]))

    def append(self, later: Self, by: int) -> Self:
        """These and those of a later part, whose pose 0 is number `by` here."""
        arrays = self._factor_arrays().items()
        own: dict[str, Any] = {name: np.concatenate([value, getattr(later, name)]) for name, value in arrays}
        return replace(self, pose_index=np.append(self.pose_index, later.pose_index + by), **own)

    def _slice_factors(self, first: int, last: int, begin: int) -> Self:
        own = {name: value[first:last] for name, value in self._factor_arrays().items()}
        return replace(self, pose_index=self.pose_index[first:last] - begin, **own)

    def _factor_arrays(self) -> dict[str, Any]:
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {
            n: value for n, value in values.items() if n != "pose_index" and isinstance(value, np.ndarray)
        }


def find_runs(flags: Flags) -> list[tuple[int, int]]:
    """First and last number of each stretch of flags that are set, gaps of up to two bridged."""
    places = np.flatnonzero(flags)
    if len(places) == 0:
        return []
    ends = np.flatnonzero(np.diff(places) > _MAX_RUN_GAP)
    firsts, lasts = np.append(0, ends + 1), np.append(ends, len(places) - 1)
    return [(int(places[a]), int(places[b])) for a, b in zip(firsts, lasts, strict=True)]


class SensorSamples(Protocol):
    """N samples of one sensor, or one that just came."""

    @property
    def pose_times(self) -> Array:
        """Times at which a pose must stand, s; none for what is carried to the nearest."""
        ...

    def build_factors(self, cut: SegmentedOdometry, config: GraphConfig) -> FactorGroup | None:
        """The factors of one kind that the samples make of the poses at cut.pose_t; None without any.

        At most one on each pose. Samples before the first pose or after the last are left out.
        """
        ...


Samples = TypeVar("Samples")


def concatenate_samples(samples: Sequence[Samples]) -> Samples:
    """Samples of one sensor put together. Each is a dataclass whose fields are all arrays."""
    kind: Any = type(samples[0])
    names = [item.name for item in fields(kind)]
    made: Samples = kind(*(np.concatenate([getattr(sample, name) for sample in samples]) for name in names))
    return made
