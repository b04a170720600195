"""The effects that could be missing: each in every scope, as combinations of directions of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hubodo.arrays import Array
from hubodo.effects import BY_NAME, Effect
from hubodo.gap.linear.directions import basis
from hubodo.gap.linear.sensitivity import Direction
from hubodo.gap.problem.problem import Problem
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm, scopes


@dataclass(frozen=True)
class Candidate:
    """An effect that may be there (or be wrong), where it would begin, and the directions that move it.

    basis: (D, k) of zeros and ones: direction d moves with coordinate k.
    """

    term: ModelTerm
    basis: Array

    @property
    def name(self) -> str:
        return self.term.effect.name


def all_directions(state: State) -> list[Direction]:
    """Every direction of every effect that shows in the mean, from where it stands or from its seeds."""
    nodes, made = state.problem.nodes, []
    for effect in BY_NAME.values():
        if effect.visible_in != "mean" or (effect.affects_reference and state.problem.sources):
            continue
        for scope in scopes(effect, nodes):
            if scope == ALL:
                continue
            node = "" if scope == VEHICLE else scope
            at = state.effects[node or nodes[0].name].get(effect)
            for seed in (at,) if at is not None else effect.initial_guesses():
                made += [Direction(seed, node, k) for k in range(len(seed.coordinates()))]
    return made


def candidates(problem: Problem, directions: Sequence[Direction]) -> list[Candidate]:
    """The candidates that a list of directions makes: each effect on each node, and on all of them."""
    groups: dict[tuple[Effect, str], list[int]] = {}
    for k, direction in enumerate(directions):
        groups.setdefault((direction.effect, direction.node), []).append(k)
    made, shared = [], dict[Effect, list[list[int]]]()
    for (effect, node), members in groups.items():
        made.append(Candidate(ModelTerm(effect, node or VEHICLE), basis(len(directions), [members])))
        if node:
            shared.setdefault(effect, []).append(members)
    for effect, parts in shared.items():
        if len(parts) > 1 and len(parts) == len(scopes(type(effect), problem.nodes)) - 1:
            made.append(Candidate(ModelTerm(effect, ALL), basis(len(directions), parts)))
    return made
