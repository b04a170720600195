"""Effects of a model under test, each with its scope."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from hubodo.arrays import Array
from hubodo.effects import Effect, sort_effects
from hubodo.gap.problem.problem import NodeData
from hubodo.model.model_file import Model, ScopedEffect

ALL = "all"
VEHICLE = "vehicle"
# 1 sigma, in usual sizes, by which an effect of the vehicle differs from one drive to the next: a mounting of
# 20 mrad by 2 mrad, a lever arm of 10 mm by 1 mm. On a real car misalignments differed by 0.7 mrad.
REPEATABILITY = 0.1


@dataclass(frozen=True)
class ModelTerm:
    """One effect in the model.

    scope: name of a node, `all` nodes, or the `vehicle`
    is_fitted: True if the search added it and later fits may change it; False if the model file gave it
    frozen: coordinates that a fit does not move
    repeatability: 1 sigma, in usual sizes, by which a given effect may differ in this drive; 0 for an effect
        that is fitted
    """

    effect: Effect
    scope: str
    is_fitted: bool = True
    frozen: tuple[int, ...] = ()
    repeatability: float = 0.0

    @property
    def key(self) -> tuple[str, str]:
        return self.effect.name, self.scope

    @property
    def is_refittable(self) -> bool:
        """Return True if a fit of the channel means can change it."""
        return self.is_fitted and self.effect.visible_in == "mean"

    @property
    def is_nuisance(self) -> bool:
        """Return True if a fit of the channel means lets a given effect differ within its repeatability."""
        return not self.is_fitted and self.repeatability > 0.0 and self.effect.visible_in == "mean"

    @property
    def label(self) -> str:
        """Return a label such as `wheel_camber (left)`."""
        return f"{self.effect.name} ({self.scope})"

    def with_coordinates(self, coordinates: Array) -> ModelTerm:
        return replace(self, effect=self.effect.with_coordinates(coordinates))

    def acts_on(self, node: NodeData) -> bool:
        """Return True if the term acts on a node."""
        if self.effect.level == "wheel" and not node.on_wheel:
            return False
        return self.scope in (ALL, VEHICLE, node.name)


def hold_given(terms: Iterable[ModelTerm]) -> list[ModelTerm]:
    """Return the terms with those of the model file held at their values."""
    return [term if term.is_fitted else replace(term, repeatability=0.0) for term in terms]


def terms_of_model(model: Model) -> tuple[ModelTerm, ...]:
    """Return the effects of a model file as terms that no fit changes, true within their repeatability."""
    return tuple(
        ModelTerm(item.effect, scope_of(item), is_fitted=False, repeatability=REPEATABILITY)
        for item in model.effects
    )


def scope_of(item: ScopedEffect) -> str:
    """Return the scope of an effect of a model file: its node, the vehicle or all nodes."""
    return item.node or (VEHICLE if item.effect.level == "vehicle" else ALL)


def model_of_terms(model: Model, terms: Iterable[ModelTerm]) -> Model:
    """Return a model file with these terms as its effects; the inverse of `terms_of_model`."""
    scoped = [
        ScopedEffect(term.effect, None if term.scope in (ALL, VEHICLE) else term.scope) for term in terms
    ]
    return replace(model, effects=()).with_effects(*scoped)


def effects_on_node(node: NodeData, terms: Iterable[ModelTerm]) -> dict[type[Effect], Effect]:
    """Return the effects on a node in the order of the sensor chain; its own replace those of all nodes."""
    chosen: dict[type[Effect], Effect] = {}
    for term in sorted(terms, key=lambda term: term.scope not in (ALL, VEHICLE)):
        if term.acts_on(node):
            chosen[type(term.effect)] = term.effect
    return {type(effect): effect for effect in sort_effects(chosen.values())}


def list_scopes(effect: type[Effect], nodes: Sequence[NodeData]) -> list[str]:
    """Return the possible scopes of an effect: the vehicle, or all nodes and each of them."""
    if effect.level == "vehicle":
        return [VEHICLE] if any(node.on_wheel for node in nodes) else []
    names = [node.name for node in nodes if effect.level == "node" or node.on_wheel]
    return [ALL, *names] if len(names) > 1 else names
