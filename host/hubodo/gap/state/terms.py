"""The effects of a model under test, each with its scope, and what each node has of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from hubodo.arrays import Array
from hubodo.effects import Effect, in_order
from hubodo.gap.problem.problem import NodeData

ALL = "all"
VEHICLE = "vehicle"


@dataclass(frozen=True)
class ModelTerm:
    """One effect in the model. scope: a node's name, `all` nodes, or the `vehicle`.

    fitted: found here, so that every later fit may move it; else it was given and stays.
    """

    effect: Effect
    scope: str
    fitted: bool = True

    @property
    def key(self) -> tuple[str, str]:
        return self.effect.name, self.scope

    @property
    def moves(self) -> bool:
        """Whether a fit of the channels moves it: what shows only in scatter has a fit of its own."""
        return self.fitted and self.effect.visible_in == "mean"

    @property
    def words(self) -> str:
        """As in `wheel_camber (left)`."""
        return f"{self.effect.name} ({self.scope})"

    def at(self, coordinates: Array) -> ModelTerm:
        return replace(self, effect=self.effect.with_coordinates(coordinates))

    def on(self, node: NodeData) -> bool:
        """Whether it acts on that node."""
        if self.effect.level == "wheel" and not node.on_wheel:
            return False
        return self.scope in (ALL, VEHICLE, node.name)


def effects_on(node: NodeData, terms: Iterable[ModelTerm]) -> dict[type[Effect], Effect]:
    """What acts on a node, in the order of the chain; its own effect goes before one that all nodes have."""
    chosen: dict[type[Effect], Effect] = {}
    for term in sorted(terms, key=lambda term: term.scope not in (ALL, VEHICLE)):
        if term.on(node):
            chosen[type(term.effect)] = term.effect
    return {type(effect): effect for effect in in_order(chosen.values())}


def scopes(effect: type[Effect], nodes: Sequence[NodeData]) -> list[str]:
    """The scopes in which an effect can be: the vehicle, or all nodes and each of them."""
    if effect.level == "vehicle":
        return [VEHICLE] if any(node.on_wheel for node in nodes) else []
    able = [node.name for node in nodes if effect.level == "node" or node.on_wheel]
    return [ALL, *able] if len(able) > 1 else able
