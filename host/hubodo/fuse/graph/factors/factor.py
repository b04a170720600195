"""The common interface of all factors, residuals with derivatives and a robust loss, and of their samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.loss import QUADRATIC, Loss

if TYPE_CHECKING:  # both modules import this one
    from hubodo.fuse.graph.config import GraphConfig
    from hubodo.fuse.graph.odometry_steps import SegmentedOdometry

Flags = NDArray[np.bool_]

_MAX_RUN_GAP = 3
"""Difference of index up to which two outliers belong to one run, with up to two inliers in between."""


class LinearisedFactors(NamedTuple):
    """M factors of one kind, r rows each, whitened and linearised at given poses and constants.

    Attributes
    ----------
    pose_index : (M,) pose to which each factor is tied.
    residual : (M, r), in sigma.
    pose_jacobian : (M, r, 3), derivatives by x, y, heading of that pose.
    next_pose_jacobian : (M, r, 3), derivatives by the pose after it, or None.
    constants_jacobian : (M, r, N_CONSTANTS).
    """

    pose_index: NDArray[np.intp]
    residual: Array
    pose_jacobian: Array
    next_pose_jacobian: Array | None
    constants_jacobian: Array

    @property
    def squared_norms(self) -> Array:
        """Return the squared norm of each factor, (M,), in units of its variance."""
        return np.asarray(np.einsum("ij,ij->i", self.residual, self.residual))


@dataclass(frozen=True, eq=False)
class FactorGroup(ABC):
    """M factors of one kind.

    The first axis of every array of a subclass counts factors, so that a graph is split and appended to
    without knowledge of the kind.

    Attributes
    ----------
    pose_index : (M,) numbers of their poses, increasing: at most one factor of a kind on each pose.
    loss : robust loss.
    """

    pose_index: NDArray[np.intp]
    loss: Loss = field(default=QUADRATIC, kw_only=True)

    @abstractmethod
    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Return whitened residuals and derivatives at poses (n, 3) and constants (N_CONSTANTS,)."""

    def describe_outliers(self, is_outlier: Flags, norm: Array, pose_t: Array) -> list[str]:
        """Return one warning for each finding in a solution.

        is_outlier: (M,) factors of low weight. norm: (M,) in sigma. pose_t: (n,) s of all poses.
        """
        return []

    def select_poses(self, start: int, end: int) -> Self:
        """Return the factors tied to poses start to end - 1; poses are renumbered from `start` on."""
        first, last = np.searchsorted(self.pose_index, [start, end])
        return self._slice_factors(int(first), int(last), start)

    def select_factor(self, i: int) -> Self:
        """Return factor i alone, tied to pose 0."""
        return self._slice_factors(i, i + 1, int(self.pose_index[i]))

    def append(self, later: Self, offset: int) -> Self:
        """Return these factors and those of a later part, whose pose 0 is number `offset` here."""
        arrays = self._factor_arrays().items()
        concatenated: dict[str, Any] = {
            name: np.concatenate([value, getattr(later, name)]) for name, value in arrays
        }
        return replace(self, pose_index=np.append(self.pose_index, later.pose_index + offset), **concatenated)

    def _slice_factors(self, first: int, last: int, start: int) -> Self:
        sliced = {name: value[first:last] for name, value in self._factor_arrays().items()}
        return replace(self, pose_index=self.pose_index[first:last] - start, **sliced)

    def _factor_arrays(self) -> dict[str, Any]:
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {
            n: value for n, value in values.items() if n != "pose_index" and isinstance(value, np.ndarray)
        }


def find_bridged_runs(flags: Flags) -> list[tuple[int, int]]:
    """Return first and last index of each run of flags that are set; gaps of up to two are bridged."""
    set_indices = np.flatnonzero(flags)
    if len(set_indices) == 0:
        return []
    ends = np.flatnonzero(np.diff(set_indices) > _MAX_RUN_GAP)
    firsts, lasts = np.append(0, ends + 1), np.append(ends, len(set_indices) - 1)
    return [
        (int(set_indices[start]), int(set_indices[end])) for start, end in zip(firsts, lasts, strict=True)
    ]


class SensorSamples(Protocol):
    """N samples of one sensor on their own times, or a single new one, that become factors of a graph."""

    @property
    def pose_times(self) -> Array:
        """Return times at which the graph must have a pose, s; empty if samples move to the nearest pose."""
        ...

    def build_factors(self, odometry: SegmentedOdometry, config: GraphConfig) -> FactorGroup | None:
        """Return the factors of these samples for the poses at odometry.pose_t; None if there are none.

        All are of one kind, at most one on each pose. Samples before the first pose or after the last are
        dropped.
        """
        ...


Samples = TypeVar("Samples")


def concatenate_samples(samples: Sequence[Samples]) -> Samples:
    """Return the samples of one sensor as one object. Each is a dataclass whose fields are all arrays."""
    kind: Any = type(samples[0])
    names = [item.name for item in fields(kind)]
    concatenated: Samples = kind(
        *(np.concatenate([getattr(sample, name) for sample in samples]) for name in names)
    )
    return concatenated
