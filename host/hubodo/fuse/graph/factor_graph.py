"""A factor graph whose poses form a chain: its factors, whatever their kinds, in one tuple."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.factor import Factor, Linear
from hubodo.fuse.graph.factors.loss import Loss

Kind = TypeVar("Kind", bound=Factor)


@dataclass(frozen=True, eq=False)
class Graph:
    """All factors, each kind at most once."""

    factors: tuple[Factor, ...]

    def linear(self, poses: Array, constants: Array) -> list[tuple[Linear, Loss]]:
        """Every kind about poses (n, 3) and constants (COUNT,)."""
        return [(factor.linear(poses, constants), factor.loss) for factor in self.factors]

    def cost(self, poses: Array, constants: Array) -> float:
        """What the solution minimises: robust losses, half of the squares."""
        return cost_of(self.linear(poses, constants))

    def find(self, kind: type[Kind]) -> Kind | None:
        """The factors of a kind, None without any."""
        return next((factor for factor in self.factors if isinstance(factor, kind)), None)

    def under(self, loss: Callable[[Factor], Loss]) -> Graph:
        """The same factors under other losses."""
        return Graph(tuple(replace(factor, loss=loss(factor)) for factor in self.factors))

    def part(self, begin: int, end: int) -> Graph:
        """The factors tied to poses begin to end - 1, numbered from `begin` on."""
        parts = (factor.part(begin, end) for factor in self.factors)
        return Graph(tuple(part for part in parts if len(part.state) > 0))

    def joined(self, later: Graph, by: int) -> Graph:
        """This graph and one that goes on from it: pose 0 there is number `by` here."""
        made: dict[type[Factor], Factor] = {type(factor): factor for factor in self.factors}
        for factor in later.factors:
            own = made.get(type(factor))
            shifted = replace(factor, state=factor.state + by)
            made[type(factor)] = shifted if own is None else own.joined(factor, by)
        return Graph(tuple(made.values()))


def cost_of(linear: list[tuple[Linear, Loss]]) -> float:
    """The cost of factors already evaluated."""
    return sum(float(loss.costs(item.squares).sum()) for item, loss in linear)
