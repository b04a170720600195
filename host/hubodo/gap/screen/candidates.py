"""Candidate effects in each scope, as combinations of directions of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hubodo.arrays import Array
from hubodo.effects import BY_NAME, Effect
from hubodo.gap.linear.directions import build_basis
from hubodo.gap.linear.sensitivity import Direction
from hubodo.gap.problem.problem import Problem
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm, list_scopes


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing or have a wrong value, at its starting values.

    basis: (D, k) of zeros and ones; direction d moves with coordinate k
    """

    term: ModelTerm
    basis: Array

    @property
    def name(self) -> str:
        return self.term.effect.name


def list_directions(state: State) -> list[Direction]:
    """Return every direction of every effect visible in the mean, about its current value or its seeds."""
    nodes, directions = state.problem.nodes, []
    for effect in BY_NAME.values():
        if effect.visible_in != "mean" or (effect.affects_reference and state.problem.speed_source_nodes):
            continue
        for scope in list_scopes(effect, nodes):
            if scope == ALL:
                continue
            node = "" if scope == VEHICLE else scope
            current = state.effects[node or nodes[0].name].get(effect)
            for seed in (current,) if current is not None else effect.initial_guesses():
                directions += [Direction(seed, node, k) for k in range(len(seed.coordinates()))]
    return directions


def list_candidates(problem: Problem, directions: Sequence[Direction]) -> list[Candidate]:
    """Return the candidates that a list of directions covers: each effect on each node, and on all nodes."""
    groups: dict[tuple[Effect, str], list[int]] = {}
    for k, direction in enumerate(directions):
        groups.setdefault((direction.effect, direction.node), []).append(k)
    result, shared = [], dict[Effect, list[list[int]]]()
    for (effect, node), members in groups.items():
        result.append(Candidate(ModelTerm(effect, node or VEHICLE), build_basis(len(directions), [members])))
        if node:
            shared.setdefault(effect, []).append(members)
    for effect, member_groups in shared.items():
        if len(member_groups) > 1 and len(member_groups) == len(list_scopes(type(effect), problem.nodes)) - 1:
            result.append(Candidate(ModelTerm(effect, ALL), build_basis(len(directions), member_groups)))
    return result
