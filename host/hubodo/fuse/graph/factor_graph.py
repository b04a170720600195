"""A factor graph whose poses form a chain: its groups of factors in one tuple."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.factor import FactorGroup, LinearisedFactors
from hubodo.fuse.graph.factors.loss import Loss

Kind = TypeVar("Kind", bound=FactorGroup)


@dataclass(frozen=True, eq=False)
class FactorGraph:
    """All factors of a graph, at most one group of each kind."""

    factors: tuple[FactorGroup, ...]

    def linearise(self, poses: Array, constants: Array) -> list[tuple[LinearisedFactors, Loss]]:
        """Linearise every group about poses (n, 3) and constants (N_CONSTANTS,)."""
        return [(factor.linearise(poses, constants), factor.loss) for factor in self.factors]

    def cost(self, poses: Array, constants: Array) -> float:
        """Return the cost that the solver minimises: robust losses, half of the squared residuals."""
        return total_cost(self.linearise(poses, constants))

    def find_group(self, kind: type[Kind]) -> Kind | None:
        """Return the factors of a kind; None if there are none."""
        return next((factor for factor in self.factors if isinstance(factor, kind)), None)

    def with_losses(self, loss_of: Callable[[FactorGroup], Loss]) -> FactorGraph:
        """Return the same factors with other losses."""
        return FactorGraph(tuple(replace(factor, loss=loss_of(factor)) for factor in self.factors))

    def select_poses(self, start: int, end: int) -> FactorGraph:
        """Return the factors tied to poses start to end - 1, renumbered from `start` on."""
        parts = (factor.select_poses(start, end) for factor in self.factors)
        return FactorGraph(tuple(part for part in parts if len(part.pose_index) > 0))

    def append(self, later: FactorGraph, offset: int) -> FactorGraph:
        """Return this graph continued by a later one, whose pose 0 is number `offset` here."""
        groups: dict[type[FactorGroup], FactorGroup] = {type(factor): factor for factor in self.factors}
        for factor in later.factors:
            earlier = groups.get(type(factor))
            shifted = replace(factor, pose_index=factor.pose_index + offset)
            groups[type(factor)] = shifted if earlier is None else earlier.append(factor, offset)
        return FactorGraph(tuple(groups.values()))


def total_cost(linear: list[tuple[LinearisedFactors, Loss]]) -> float:
    """Return the cost of linearised factors."""
    return sum(float(loss.cost(item.squared_norms).sum()) for item, loss in linear)
