"""Gauss-Newton: the free terms of a model fitted to all that was measured, the wheels' paths with them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from hubodo.arrays import Array
from hubodo.gap.linear.directions import moved, term_directions
from hubodo.gap.linear.linearised import Linearised, linearise, solved
from hubodo.gap.process_noise.point import Point
from hubodo.gap.process_noise.tracking import own_weights, track_wheel_phase
from hubodo.gap.process_noise.weights import weights_of
from hubodo.gap.state.state import ATTITUDE_SCALE, State
from hubodo.gap.state.terms import ModelTerm
from hubodo.model.forward import NodeInitialState

_ROUNDS = 6
# Scales that one step may move a coordinate: beyond that nothing is linear.
_LONGEST = 8.0
# A step of so many sigma is as good as none; a deviance that grows by so much has not grown. Where what is
# left is no noise, sigma is that of the scatter of the scores: a log that no model fits is not fitted to the
# nat.
_ARRIVED, _SLACK = 0.2, 3.0
# Parts of a step that are tried; one is taken when it brings at least half of what it promised.
_PARTS = (1.0, 0.3, 0.1)
_KEPT = 0.5
# Where a round leaves more than this of the step there was, and brings no likelihood, a fit goes in circles.
_CIRCLES = 0.7
# A scatter of the scores that is as likely as this, or likelier, is taken for chance: that is 1 sigma.
_BY_CHANCE = 0.16
# Rounds after which a fit that is hopeless ends.
_TRIED = 2
# Rounds in which weights and fit may come to agree.
_AGREED = 5


@dataclass(frozen=True)
class Refit:
    """A refit: where it ended, and what it knows there.

    point: where the fit ended. free: the terms it moved. covariance: (K, K) of the free coordinates in
    scales, as independent samples would have it. robust: the same from the scatter of the scores of blocks.
    deviance: -2 ln likelihood, up to what is common to all refits with the same weights. score: (B, K), what
    each block says about the coordinates. whole_covariance: with the nuisances. gram: the information about
    all of them, and the residual's row.
    """

    point: Point
    free: tuple[ModelTerm, ...]
    covariance: Array
    robust: Array
    deviance: float
    score: Array
    whole_covariance: Array
    gram: Array

    @property
    def state(self) -> State:
        return self.point.state

    @property
    def step(self) -> Array:
        """(K + nuisances,) in scales: from there to where a linear model is fitted."""
        return np.asarray(self.whole_covariance @ self.gram[:-1, -1])

    def bare(self) -> Refit:
        """For keeping: see `Point.bare`."""
        return replace(self, point=self.point.bare())

    def place(self, term: ModelTerm) -> slice:
        """Where the coordinates of a free term stand."""
        at = 0
        for other in self.free:
            size = len(other.effect.coordinates())
            if other.key == term.key:
                return slice(at, at + size)
            at += size
        raise KeyError(term.key)

    def information(self, term: ModelTerm) -> Array:
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
        """By how much the scatter of the scores exceeds what independent samples would give, at least 1.

        Few blocks scatter by themselves: what one in six of such logs would show by chance is taken off.
        """
        seen = int(np.count_nonzero(np.diag(self.covariance)))
        if not seen:
            return 1.0
        share = np.trace(self.score.T @ self.score @ self.covariance) / seen
        freedom = seen * max(len(self.score) - 1.0, 1.0)
        return max(1.0, float(share * freedom / chdtri(freedom, _BY_CHANCE)))


def gain_over(before: Refit, made: Refit) -> float:
    """Of ln likelihood, from one fit to another with the same weights."""
    return 0.5 * (before.deviance - made.deviance)


def refit(point: Point, rounds: int = _ROUNDS) -> Refit:
    """All terms that are `fitted`, moved to where the data want them; the weights stay."""
    return fit_tracked(point.at(track_wheel_phase(point.state)[0]), rounds)


def fit_tracked(point: Point, rounds: int = _ROUNDS) -> Refit:
    """As `refit`, from a state whose wheels have been tracked. rounds: 1 for the whole step, or none."""
    return fit_from(look_from(point), rounds)


def fit_from(best: Refit, rounds: int = _ROUNDS, hopeless: float = math.inf) -> Refit:
    """As `fit_tracked`, from a first look. hopeless: deviance beyond which only two rounds are tried."""
    size = _sigmas(best)
    for done in range(rounds):
        tempering = best.tempering
        slack = _SLACK * tempering
        if size**2 < _ARRIVED**2 * tempering or (done >= _TRIED and best.deviance > hopeless):
            break
        # The deviance counts the step already; when it grows, the step left the linear range.
        for part in _PARTS if rounds > 1 else _PARTS[:1]:
            further, _walks = track_wheel_phase(_stepped(best, part * best.step))
            made = look_from(best.point.at(further))
            if made.deviance < best.deviance + slack + _KEPT * size**2:
                break
        else:
            break
        before, was = best.deviance, size
        best, size = made, _sigmas(made)
        if best.deviance > before - slack and size > _CIRCLES * was:
            break
    return best


def _sigmas(made: Refit) -> float:
    """How long its step is."""
    step = made.step
    return float(np.sqrt(step @ np.linalg.pinv(made.whole_covariance) @ step)) if len(step) else 0.0


def refit_with_weights(state: State) -> Refit:
    """A fit and weights that agree with it: what moves a wheel rightly leaves it less to wander."""
    tracked, _walks = track_wheel_phase(state)
    made = fit_tracked(Point(tracked, own_weights(tracked)))
    for _ in range(_AGREED):
        tracked, walks = track_wheel_phase(made.state)
        if all(walks[name] > 0.5 * walk for name, walk in made.point.weights.walks.items()):
            break
        made = fit_tracked(Point(tracked, weights_of(tracked, walks)))
    return made


def look_from(point: Point, known: Linearised | None = None) -> Refit:
    """Everything at one point, before any step. known: linearised there, along more than its terms."""
    free = [term for term in point.state.terms if term.moves]
    directions, basis = term_directions(point.problem, free)
    linear = linearise(point, directions) if known is None else known.along(directions)
    whole = np.zeros((len(directions) + linear.nuisances + 1, basis.shape[1] + linear.nuisances + 1))
    whole[: len(directions), : basis.shape[1]] = basis
    rest = linear.nuisances + 1
    whole[-rest:, -rest:] = np.eye(rest)
    blocks = np.einsum("dk,bde,ef->bkf", whole, linear.blocks.whole(), whole, optimize=True)
    gram = blocks.sum(axis=0)
    inverse = solved(gram[:-1, :-1], (whole.T**2 @ linear.raw)[:-1])
    step = inverse @ gram[:-1, -1]
    score = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ step
    robust = inverse @ (score.T @ score) @ inverse
    deviance = float(gram[-1, -1] - gram[:-1, -1] @ step) + linear.logs
    k = basis.shape[1]
    return Refit(point, tuple(free), inverse[:k, :k], robust[:k, :k], deviance, score[:, :k], inverse, gram)


def _stepped(made: Refit, step: Array) -> State:
    count = len(made.covariance)
    own = step[:count] * min(1.0, _LONGEST / max(float(np.abs(step[:count]).max(initial=0.0)), 1e-9))
    parts = [own[made.place(term)] for term in made.free]
    fitted = iter(moved(made.free, parts))
    terms = tuple(next(fitted) if term.moves else term for term in made.state.terms)
    starts = dict(made.state.starts)
    bodies = [node for node in made.state.problem.nodes if not node.on_wheel]
    for node, turn in zip(bodies, step[count:].reshape(-1, 3), strict=True):
        new = np.array(made.state.start(node).attitude) + np.clip(turn, -4.0, 4.0) * ATTITUDE_SCALE
        starts[node.name] = NodeInitialState(attitude=(float(new[0]), float(new[1]), float(new[2])))
    return replace(made.state, terms=terms, starts=starts)
