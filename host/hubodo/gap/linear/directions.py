"""Terms as directions: which coordinates of the model move together, and terms moved along them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.linear.sensitivity import Direction
from hubodo.gap.problem.problem import Problem
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm

# A step that leads beyond what is possible is halved so many times before it is given up.
_SHORTER = 8


def basis(count: int, parts: Sequence[Sequence[int]]) -> Array:
    """(count, k): the k-th of each part moves together."""
    made = np.zeros((count, len(parts[0])))
    for part in parts:
        made[list(part), range(len(part))] = 1.0
    return made


def term_directions(problem: Problem, terms: Sequence[ModelTerm]) -> tuple[list[Direction], Array]:
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


def moved(terms: Sequence[ModelTerm], step: Sequence[Array]) -> list[ModelTerm]:
    """The terms, each moved by its step, (k,) in scales of its coordinates; less where that means nothing."""
    made = []
    for term, by in zip(terms, step, strict=True):
        for _ in range(_SHORTER):
            there = term.at(term.effect.coordinates() + by * term.effect.coordinate_scales())
            if there.effect.is_valid():
                break
            by = 0.5 * by
        else:
            there = term
        made.append(there)
    return made
