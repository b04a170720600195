"""One round of the search: every effect in every scope screened, the best refitted, all judged together."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import EFFECTS
from hubodo.effects.empirical import PREFIX
from hubodo.gap.bootstrap import Chance
from hubodo.gap.linearised import declared_walk, settle
from hubodo.gap.posterior import NOTHING, UNLISTED, WIDE, log_evidence, posterior, priors
from hubodo.gap.problem import Problem
from hubodo.gap.refit import Refit, refit
from hubodo.gap.scatter import LOOKS, Proposal
from hubodo.gap.scatter.base import rests
from hubodo.gap.screening import Screened, screen, state_with
from hubodo.gap.state import State
from hubodo.gap.terms import Term
from hubodo.gap.unlisted import Structure, unlisted
from hubodo.gap.wander import Weights

EMPIRICAL = "empirical"
_REFITTED = 5
# Where a wheel wanders so many times more than declared, so many more are refitted.
_LOST, _STRICT = 30.0, 3
# Structures without a name are fitted, so many of them, when they promise this share of the best gain.
_STRUCTURES, _SHARE, _LEAST = 2, 0.4, 3.0
# A refit that gains so many times what the linear model promised has found something else.
_PROMISED = 20.0


@dataclass(frozen=True)
class Rival:
    """One candidate of a round. gain: in ln likelihood. evidence: ln Bayes factor against its absence.
    probability: among all of its round, and nothing. refit: with it; proposal: of a look at scatter."""

    term: Term
    gain: float
    evidence: float
    probability: float
    refit: Refit | None = None
    proposal: Proposal | None = None

    @property
    def label(self) -> tuple[str, str]:
        return self.term.key

    def p_value(self, chance: Chance) -> float:
        """How often the best of all would gain as much by chance."""
        return chance.p_value(self.gain, len(self.term.effect.coordinates()))


@dataclass(frozen=True)
class Round:
    """One round: the state it began with, its rivals, the most probable first, and the chance of nothing.

    screened: every candidate as the linear model saw it, the best first. chance: what the best of them would
    gain by chance.
    """

    before: Refit
    weights: Weights
    rivals: tuple[Rival, ...]
    nothing: float
    screened: tuple[Screened, ...]
    chance: Chance

    @property
    def best(self) -> Rival | None:
        """The rival to be added; None where nothing is too likely."""
        return self.rivals[0] if self.rivals and self.nothing < 1.0 - DECIDED else None

    def rival(self, label: tuple[str, str]) -> Rival | None:
        """The rival of this effect and scope, where it was one."""
        return next((rival for rival in self.rivals if rival.label == label), None)


# An effect is added when it is so sure that anything is missing at all.
DECIDED = 0.99


def look(
    problem: Problem,
    state: State,
    weighed: Weights,
    reject: Collection[str] = (),
    also: Collection[tuple[str, str]] = (),
) -> Round:
    """One round from a state.

    reject: names that are not considered, `empirical` for all without a name. also: effects and scopes that
    are judged however little they promise.
    """
    before = refit(problem, state, weighed, rounds=1)
    screening = screen(problem, before.state, weighed)
    screened = [it for it in screening.candidates if it.candidate.name not in reject]
    worth = _shortlist(screened, _REFITTED)
    asked = [next(it for it in screened if it.candidate.term.key == key) for key in also]
    for it in [*asked, *_strict(problem, before, weighed, reject)]:
        if it.candidate.term.key not in [other.candidate.term.key for other in worth]:
            worth.append(it)
    refits = [refit(problem, state_with(before.state, it.candidate.term), weighed) for it in worth]
    if refits:
        # All candidates are judged with wheels that wander as little as under the best of them.
        walks = [settle(problem, it.state)[1] for it in refits]
        least = {node: min(own[node] for own in walks) for node in weighed.walks}
        weighed = Weights(weighed.noise, {node: min(q, least[node]) for node, q in weighed.walks.items()})
        before = refit(problem, before.state, weighed, rounds=0)
        refits = [refit(problem, it.state, weighed, rounds=1) for it in refits]
    seen = rests(problem, before.state, weighed)
    proposals = [it for one_look in LOOKS for it in one_look(seen) if it.term.effect.name not in reject]
    walkers = {
        it.term.key: refit(problem, state_with(before.state, it.term), weighed, rounds=0)
        for it in proposals
        if it.term.effect.drift() > 0.0
    }
    best = max([_gain(before, it) for it in [*refits, *walkers.values()]], default=0.0)
    structures = [] if EMPIRICAL in reject else unlisted(problem, before.state, seen)
    structures = [it for it in structures if it.evidence > max(_LEAST, _SHARE * best)][:_STRUCTURES]
    terms = [refit(problem, state_with(before.state, it.term), weighed, rounds=1) for it in structures]
    everything = [*refits, *walkers.values(), *terms]
    # The scores of the best fit say by how much correlation makes every gain look larger than it is.
    tempering = min(everything, key=lambda it: it.deviance).tempering if everything else 1.0
    rows = [_named(before, it, made, tempering) for it, made in zip(worth, refits, strict=True)]
    rows += [_scattered(before, it, walkers.get(it.term.key), tempering) for it in proposals]
    rows += [_unnamed(before, it, made, tempering) for it, made in zip(structures, terms, strict=True)]
    return Round(before, weighed, *_judged(rows), tuple(screened), screening.chance)


def _gain(before: Refit, made: Refit) -> float:
    return 0.5 * (before.deviance - made.deviance)


def _shortlist(screened: list[Screened], count: int) -> list[Screened]:
    """The best few, none that is hopeless beside the best, and the best seed of each effect and scope."""
    made: list[Screened] = []
    keys: set[tuple[str, str]] = set()
    for it in screened:
        if it.evidence < 0.0 or len(made) == count:
            break
        if it.candidate.term.key not in keys:
            keys.add(it.candidate.term.key)
            made.append(it)
    return made


def _strict(problem: Problem, before: Refit, weighed: Weights, reject: Collection[str]) -> list[Screened]:
    """What explains how a wheel turns that is lost.

    A wheel that turns another way than the model's passes for one that wanders, and what makes it turn so has
    nothing to explain: it has where only the declared wandering is allowed.
    """
    believed = {node.name: declared_walk(problem, node) for node in problem.nodes if node.on_wheel}
    if all(weighed.walks[name] <= _LOST * walk for name, walk in believed.items()):
        return []
    strict = screen(problem, before.state, replace(weighed, walks=believed)).candidates
    return _shortlist([it for it in strict if it.candidate.name not in reject], _STRICT)


def _named(before: Refit, screened: Screened, made: Refit, tempering: float) -> Rival:
    term = next(term for term in made.free if term.key == screened.candidate.term.key)
    gain = min(_gain(before, made), _PROMISED * screened.gain + 20.0)
    evidence = _evidence(screened, made.information(term), gain, tempering) - term.effect.surprise()
    return Rival(term, gain, evidence, 0.0, made)


def _scattered(before: Refit, proposal: Proposal, walker: Refit | None, tempering: float) -> Rival:
    """A walk is judged as the other effects are, with the paths of the wheels left free."""
    gain = proposal.gain if walker is None else _gain(before, walker)
    evidence = gain / tempering - (proposal.gain - proposal.evidence)
    return Rival(proposal.term, gain, evidence, 0.0, None, proposal)


def _unnamed(before: Refit, structure: Structure, made: Refit, tempering: float) -> Rival:
    term = next(term for term in made.free if term.key == structure.term.key)
    gain = min(_gain(before, made), _PROMISED * structure.gain + 20.0)
    return Rival(term, gain, gain / tempering - (structure.gain - structure.evidence), 0.0, made)


def _judged(rows: list[Rival]) -> tuple[tuple[Rival, ...], float]:
    """The rivals with their probabilities, the most probable first, and that of nothing."""
    names = [row.term.effect.name for row in rows]
    prior = [
        UNLISTED if name.startswith(PREFIX) else one
        for name, one in zip(names, priors(names, len(EFFECTS)), strict=True)
    ]
    scores = {str(k): row.evidence + prior[k] for k, row in enumerate(rows)}
    share = posterior({**scores, "nothing": NOTHING})
    rivals = [replace(row, probability=share[str(k)]) for k, row in enumerate(rows)]
    return tuple(sorted(rivals, key=lambda it: -it.probability)), share["nothing"]


def _evidence(screened: Screened, information: Array, gain: float, tempering: float) -> float:
    """ln Bayes factor after the refit.

    The linear model where the candidate begins says which of its coordinates are at work; what it could not
    see there (the time constant of nothing) is paid for where the refit ended.
    """
    linear = log_evidence(screened.gain / tempering, screened.value, screened.information / tempering)
    unseen = (np.diag(screened.information) <= 0.0) & (np.diag(information) > 0.0)
    extra = 0.5 * float(np.sum(np.log1p(WIDE**2 * np.diag(information)[unseen] / tempering)))
    return linear + (gain - screened.gain) / tempering - extra
