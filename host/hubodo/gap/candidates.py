"""The effects that could be missing: each in every scope, as combinations of directions of the model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import EFFECTS, Effect
from hubodo.gap.problem import Problem
from hubodo.gap.sensitivity import Direction
from hubodo.gap.state import State, effects_of
from hubodo.gap.terms import ALL, VEHICLE, Term, scopes

_SHORTER = 8


@dataclass(frozen=True)
class Candidate:
    """An effect that may be there (or be wrong), where it would begin, and the directions that move it.

    basis: (D, k) of zeros and ones: direction d moves with coordinate k.
    """

    term: Term
    basis: Array

    @property
    def name(self) -> str:
        return self.term.effect.name


def all_directions(problem: Problem, state: State, skip: Iterable[str] = ()) -> list[Direction]:
    """Every direction of every effect that shows in the mean, from where it stands or from its seeds."""
    skip = set(skip)
    present = effects_of(problem, state.terms)
    made = []
    for effect in EFFECTS:
        if effect.shows != "mean" or effect.name in skip:
            continue
        for scope in scopes(effect, problem.nodes):
            if scope == ALL:
                continue
            node = "" if scope == VEHICLE else scope
            any_node = node or problem.nodes[0].name
            at = present[any_node].get(effect)
            for seed in (at,) if at is not None else effect.seeds():
                made += [Direction(seed, node, k) for k in range(len(seed.coordinates()))]
    return made


def candidates(problem: Problem, directions: Sequence[Direction]) -> list[Candidate]:
    """The candidates that a list of directions makes: each effect on each node, and on all of them."""
    groups: dict[tuple[Effect, str], list[int]] = {}
    for k, direction in enumerate(directions):
        groups.setdefault((direction.effect, direction.node), []).append(k)
    made, shared = [], dict[Effect, list[list[int]]]()
    for (effect, node), members in groups.items():
        made.append(Candidate(Term(effect, node or VEHICLE), basis(len(directions), [members])))
        if node:
            shared.setdefault(effect, []).append(members)
    for effect, parts in shared.items():
        if len(parts) > 1 and len(parts) == len(scopes(type(effect), problem.nodes)) - 1:
            made.append(Candidate(Term(effect, ALL), basis(len(directions), parts)))
    return made


def basis(count: int, parts: Sequence[Sequence[int]]) -> Array:
    """(count, k): the k-th of each part moves together."""
    made = np.zeros((count, len(parts[0])))
    for part in parts:
        made[list(part), range(len(part))] = 1.0
    return made


def term_directions(problem: Problem, terms: Sequence[Term]) -> tuple[list[Direction], Array]:
    """Directions that move given terms, and the basis (D, K) over the coordinates of all of them in order."""
    directions: list[Direction] = []
    blocks: list[tuple[list[list[int]], int]] = []
    for term in terms:
        own = {t.scope for t in terms if t.key[0] == term.key[0]}
        nodes = [""] if term.scope == VEHICLE else [n.name for n in problem.nodes if term.on(n)]
        if term.scope == ALL:
            nodes = [name for name in nodes if name not in own]
        size = len(term.effect.coordinates())
        parts = []
        for node in nodes:
            parts.append(list(range(len(directions), len(directions) + size)))
            directions += [Direction(term.effect, node, k) for k in range(size)]
        blocks.append((parts, size))
    made = np.zeros((len(directions), sum(size for _, size in blocks)))
    at = 0
    for parts, size in blocks:
        for part in parts:
            made[part, range(at, at + size)] = 1.0
        at += size
    return directions, made


def moved(terms: Sequence[Term], step: Sequence[Array]) -> list[Term]:
    """The terms, each moved by its step, (k,) in scales of its coordinates; less where that means nothing."""
    made = []
    for term, by in zip(terms, step, strict=True):
        for _ in range(_SHORTER):
            there = term.at(term.effect.coordinates() + by * term.effect.coordinate_scales())
            if there.effect.is_possible():
                break
            by = 0.5 * by
        else:
            there = term
        made.append(there)
    return made
