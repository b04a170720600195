"""Directions of terms, which are sets of coordinates that change together, and steps along them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.plausibility import limit_to_plausible
from hubodo.gap.linear.sensitivity import Direction
from hubodo.gap.problem.problem import Problem
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm

# Number of halvings of a step to impossible parameters before it is rejected.
_MAX_HALVINGS = 8


def build_basis(count: int, groups: Sequence[Sequence[int]]) -> Array:
    """Return a basis, (count, k), whose k-th vector moves the k-th index of each group together."""
    matrix = np.zeros((count, len(groups[0])))
    for group in groups:
        matrix[list(group), range(len(group))] = 1.0
    return matrix


def directions_of_terms(
    problem: Problem, terms: Sequence[ModelTerm], others: Sequence[ModelTerm] = ()
) -> tuple[list[Direction], Array]:
    """Return the directions of terms, and a basis, (D, K), over all their coordinates in order.

    others: further terms of the model; on a node with a term of its own, that of all nodes has no effect
    """
    directions: list[Direction] = []
    blocks: list[tuple[list[list[int]], int]] = []
    for term in terms:
        scopes = {t.scope for t in (*terms, *others) if t.key[0] == term.key[0]}
        nodes = [""] if term.scope == VEHICLE else [n.name for n in problem.nodes if term.acts_on(n)]
        if term.scope == ALL:
            nodes = [name for name in nodes if name not in scopes]
        size = len(term.effect.coordinates())
        groups = []
        for node in nodes:
            groups.append(list(range(len(directions), len(directions) + size)))
            directions += [Direction(term.effect, node, k) for k in range(size)]
        blocks.append((groups, size))
    matrix = np.zeros((len(directions), sum(size for _, size in blocks)))
    column = 0
    for groups, size in blocks:
        for group in groups:
            matrix[group, range(column, column + size)] = 1.0
        column += size
    return directions, matrix


def move_terms(terms: Sequence[ModelTerm], steps: Sequence[Array]) -> list[ModelTerm]:
    """Return the terms, each moved by its step, (k,) in scales of its coordinates.

    A step to impossible parameters is shortened. Frozen coordinates retain their values exactly: the inverse
    of an information matrix leaves them steps of rounding errors.
    """
    result = []
    for term, full_step in zip(terms, steps, strict=True):
        step = np.array(full_step)
        step[list(term.frozen)] = 0.0
        for _ in range(_MAX_HALVINGS):
            candidate = term.with_coordinates(
                term.effect.coordinates() + step * term.effect.coordinate_scales()
            )
            candidate = replace(candidate, effect=limit_to_plausible(candidate.effect))
            if candidate.effect.is_valid():
                break
            step = 0.5 * step
        else:
            candidate = term
        result.append(candidate)
    return result
