"""A factor graph whose poses form a chain: its factors, whatever their kinds, in one tuple."""

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
    """All factors, each kind at most once."""

    factors: tuple[FactorGroup, ...]

    def linearise(self, poses: Array, constants: Array) -> list[tuple[LinearisedFactors, Loss]]:
        """Every kind about poses (n, 3) and constants (COUNT,)."""
        return [(factor.linearise(poses, constants), factor.loss) for factor in self.factors]

    def cost(self, poses: Array, constants: Array) -> float:
        """What the solution minimises: robust losses, half of the squares."""
        return total_cost(self.linearise(poses, constants))

    def find(self, kind: type[Kind]) -> Kind | None:
        """The factors of a kind, None without any."""
        return next((factor for factor in self.factors if isinstance(factor, kind)), None)

    def with_losses(self, loss: Callable[[FactorGroup], Loss]) -> FactorGraph:
        """The same factors under other losses."""
        return FactorGraph(tuple(replace(factor, loss=loss(factor)) for factor in self.factors))

    def select_poses(self, begin: int, end: int) -> FactorGraph:
        """The factors tied to poses begin to end - 1, numbered from `begin` on."""
        parts = (factor.select_poses(begin, end) for factor in self.factors)
        return FactorGraph(tuple(part for part in parts if len(part.pose_index) > 0))

    def append(self, later: FactorGraph, by: int) -> FactorGraph:
        """This graph and one that goes on from it: pose 0 there is number `by` here."""
        made: dict[type[FactorGroup], FactorGroup] = {type(factor): factor for factor in self.factors}
        for factor in later.factors:
            own = made.get(type(factor))
            shifted = replace(factor, pose_index=factor.pose_index + by)
            made[type(factor)] = shifted if own is None else own.append(factor, by)
        return FactorGraph(tuple(made.values()))


def total_cost(linear: list[tuple[LinearisedFactors, Loss]]) -> float:
    """The cost of factors already evaluated."""
    return sum(float(loss.cost(item.squared_norms).sum()) for item, loss in linear)
