"""Gauss-Newton: the free terms of a model fitted to all that was measured, the wheels' paths with them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.candidates import moved, term_directions
from hubodo.gap.linearised import Linearised, linearise, settle, solved
from hubodo.gap.problem import Problem
from hubodo.gap.sensitivity import ATTITUDE_SCALE
from hubodo.gap.state import State
from hubodo.gap.terms import Term
from hubodo.gap.wander import Weights
from hubodo.model.forward import Start

_ROUNDS = 6
_LONGEST = 8.0
# A step of so many sigma is as good as none; a deviance that grows by so much has not grown.
_ARRIVED, _SLACK = 0.2, 3.0
# A step is taken when it brings at least half of what it promised.
_KEPT = 0.5


@dataclass(frozen=True)
class Refit:
    """state: fitted. linearised: about it, over the free terms. covariance: (K, K) of the free coordinates in
    scales, as independent samples would have it. robust: the same from the scatter of the scores of blocks.
    deviance: -2 ln likelihood, up to what is common to all refits with the same weights. score: (B, K), what
    each block says about the coordinates. whole_covariance: with the nuisances.
    gram: the information about all of them, and the residual's row."""

    state: State
    free: tuple[Term, ...]
    linearised: Linearised
    covariance: Array
    robust: Array
    deviance: float
    score: Array
    whole_covariance: Array
    gram: Array

    def place(self, term: Term) -> slice:
        """Where the coordinates of a free term stand."""
        at = 0
        for other in self.free:
            size = len(other.effect.coordinates())
            if other.key == term.key:
                return slice(at, at + size)
            at += size
        raise KeyError(term.key)

    def information(self, term: Term) -> Array:
        """(k, k) about the coordinates of a free term, everything else fitted; zero for what is not seen."""
        own = np.arange(len(self.whole_covariance))[self.place(term)]
        rest = np.setdiff1d(np.arange(len(self.whole_covariance)), own)
        rest = rest[np.diag(self.whole_covariance)[rest] > 0.0]
        cross = self.gram[np.ix_(own, rest)]
        inner = self.gram[np.ix_(rest, rest)]
        made = self.gram[np.ix_(own, own)] - cross @ np.linalg.pinv(inner, hermitian=True) @ cross.T
        seen = np.diag(self.whole_covariance)[own] > 0.0
        return np.asarray(made * np.outer(seen, seen))

    @property
    def tempering(self) -> float:
        """By how much the scatter of the scores exceeds what independent samples would give, at least 1."""
        if not self.covariance.size:
            return 1.0
        share = np.trace(self.score.T @ self.score @ self.covariance) / len(self.covariance)
        return max(1.0, float(share))


def refit(problem: Problem, state: State, weights: Weights, rounds: int = _ROUNDS) -> Refit:
    """All terms that are `fitted`, moved to where the data want them."""
    state, _walks = settle(problem, state)
    best, step = _look(problem, state, weights)
    for _ in range(rounds):
        size = float(np.sqrt(step @ np.linalg.pinv(best.whole_covariance) @ step)) if len(step) else 0.0
        if size < _ARRIVED:
            break
        # The deviance counts the step already; when it grows, the step left the linear range.
        for part in (1.0, 0.3, 0.1):
            further, _walks = settle(problem, _stepped(problem, best, part * step))
            made, next_step = _look(problem, further, weights)
            if made.deviance < best.deviance + _SLACK + _KEPT * size**2:
                break
        else:
            break
        best, step = made, next_step
    return best


def _look(problem: Problem, state: State, weights: Weights) -> tuple[Refit, Array]:
    """Everything at one state, and the step (K + nuisances,) from there."""
    free = [term for term in state.terms if term.moves]
    directions, basis = term_directions(problem, free)
    linear = linearise(problem, state, directions, weights)
    whole = np.zeros((len(directions) + linear.nuisances + 1, basis.shape[1] + linear.nuisances + 1))
    whole[: len(directions), : basis.shape[1]] = basis
    rest = linear.nuisances + 1
    whole[-rest:, -rest:] = np.eye(rest)
    blocks = np.einsum("dk,bde,ef->bkf", whole, linear.blocks, whole, optimize=True)
    gram = blocks.sum(axis=0)
    inverse = solved(gram[:-1, :-1], (whole.T**2 @ linear.raw)[:-1])
    step = inverse @ gram[:-1, -1]
    score = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ step
    robust = inverse @ (score.T @ score) @ inverse
    deviance = float(gram[-1, -1] - gram[:-1, -1] @ step) + linear.logs
    k = basis.shape[1]
    return Refit(
        state, tuple(free), linear, inverse[:k, :k], robust[:k, :k], deviance, score[:, :k], inverse, gram
    ), step


def _stepped(problem: Problem, made: Refit, step: Array) -> State:
    count = len(made.covariance)
    own = step[:count] * min(1.0, _LONGEST / max(float(np.abs(step[:count]).max(initial=0.0)), 1e-9))
    parts = [own[made.place(term)] for term in made.free]
    fitted = iter(moved(made.free, parts))
    terms = tuple(next(fitted) if term.moves else term for term in made.state.terms)
    starts = dict(made.state.starts)
    bodies = [node for node in problem.nodes if not node.on_wheel]
    for node, turn in zip(bodies, step[count:].reshape(-1, 3), strict=True):
        old = np.array(starts.get(node.name, Start()).attitude)
        new = old + np.clip(turn, -4.0, 4.0) * ATTITUDE_SCALE
        starts[node.name] = Start(attitude=(float(new[0]), float(new[1]), float(new[2])))
    return replace(made.state, terms=terms, starts=starts)
