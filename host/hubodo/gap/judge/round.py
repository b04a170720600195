"""One round of the search: every effect in every scope screened, the best refitted, all judged together."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.posterior import judged
from hubodo.gap.judge.rival import Rival, named_rival, scattered_rival, unnamed_rival
from hubodo.gap.process_noise.point import Point
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.process_noise.weights import Weights, declared_walk
from hubodo.gap.refit.refit import Refit, fit_from, fit_tracked, gain_over, look_from, refit
from hubodo.gap.scatter import LOOKS, Proposal
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.screen.screening import Screened, screen
from hubodo.gap.screen.unlisted import Structure, unlisted

# The name under which all terms without a name are rejected.
EMPIRICAL = "empirical"
# All that follow are settings of the search, chosen; `make gap-matrix` judges them together.
# Probability that anything is missing at all, from which on an effect is added.
DECIDED = 0.99
# Candidates that are refitted: the time of a round goes with their number.
_REFITTED = 5
# Of the deviance in units of its tempering: half of what the best gains, from which on the rest are hopeless.
_FAR = 100.0
# Ratio of a wheel's walk to the declared one, both rad²/s, from which on the wheel counts as lost; candidates
# that are refitted beside, then.
_LOST, _STRICT = 3.0, 3
# Structures without a name that are fitted; the share of the best gain and the evidence, in ln Bayes factor,
# that each has to promise.
_STRUCTURES, _SHARE, _LEAST = 2, 0.25, 3.0
# ln Bayes factor of independent samples from which on a name is added to see what comes after it.
_HOPED = 20.0
# Of the time of a round, what is behind it when all is screened, fitted, and weighed alike.
_SCREENED, _FITTED, _BESIDE = 0.15, 0.6, 0.9

Say = Callable[[str, float], None]
"""Gets what is tried, in words, and the share of it all that is done."""


@dataclass(frozen=True)
class Round:
    """One round: where it began, its rivals, the most probable first, and the chance of nothing.

    Of the first alone it is kept how its refit ended: the search may go on from there.
    screened: every candidate as the linear model saw it, the best first. null: what the best of them would
    gain by chance. tempering: by which the gains were divided, for what is left that samples share.
    """

    before: Point
    rivals: tuple[Rival, ...]
    nothing: float
    screened: tuple[Screened, ...]
    null: NullDistribution
    tempering: float = 1.0

    @property
    def best(self) -> Rival | None:
        """The rival to be added; None where nothing is too likely."""
        return self.rivals[0] if self.rivals and self.nothing < 1.0 - DECIDED else None

    @property
    def hopeful(self) -> Rival | None:
        """The rival that would be added if all that its fit leaves were noise; None where there is a best.

        Where several effects are missing, each fit leaves what the others make, and no gain is believed.
        """
        if self.best is not None or not self.rivals:
            return None
        first = self.rivals[0]
        plain = first.evidence + first.gain * (1.0 - 1.0 / self.tempering)
        named = not first.term.effect.name.startswith(PREFIX)
        return first if named and first.evidence > 0.0 and plain > _HOPED else None

    def rival(self, label: tuple[str, str]) -> Rival | None:
        """The rival of this effect and scope, where it was one."""
        return next((rival for rival in self.rivals if rival.label == label), None)


def look(
    point: Point,
    reject: Collection[str] = (),
    also: Collection[tuple[str, str]] = (),
    say: Say = lambda words, share: None,
) -> Round:
    """One round from a point.

    reject: names that are not considered, `empirical` for all without a name. also: effects and scopes that
    are judged however little they promise. say: gets what is tried, and the share of the round behind it.
    """
    say("every effect in every scope", 0.0)
    before = refit(point.bare(), rounds=1)
    strict = _strict(before, reject)
    screening = screen(before.point)
    screened = [it for it in screening.candidates if it.candidate.name not in reject]
    worth = _worth_a_refit(screened, also, strict)
    states = [before.state.with_term(it.candidate.term) for it in worth]
    begun = [look_from(before.point.at(state), screening.linear) for state in states]
    null = screening.null
    del screening  # Its matrices are large, and no longer needed.
    refits: list[Refit] = []
    for k, (it, one) in enumerate(zip(worth, begun, strict=True)):
        say(it.candidate.term.words, _SCREENED + (_FITTED - _SCREENED) * k / len(worth))
        refits.append(fit_from(one, hopeless=_hopeless(before, refits)).bare())
    say("the best beside each other", _FITTED)
    if refits:
        tracked = [track_wheel_phase(it.bare().state) for it in refits]
        weights = _strictest(before.point.weights, [walks for _, walks in tracked])
        before = refit(Point(before.state, weights), rounds=0)
        refits = [fit_tracked(Point(replace(state), weights), rounds=1).bare() for state, _ in tracked]
    say("scatter, steps, limits, terms without a name", _BESIDE)
    proposals, walkers = _scattered(before, reject)
    best = max([gain_over(before, it) for it in [*refits, *walkers.values()]], default=0.0)
    structures = [] if EMPIRICAL in reject else unlisted(before.point)
    structures = [it for it in structures if it.evidence > max(_LEAST, _SHARE * best)][:_STRUCTURES]
    terms = [_with(before, it, rounds=1) for it in structures]
    everything = [*refits, *walkers.values(), *terms]
    # The scores of the best fit say by how much correlation makes every gain look larger than it is.
    tempering = min(everything, key=lambda it: it.deviance).tempering if everything else 1.0
    rivals = [named_rival(before, it, made, tempering) for it, made in zip(worth, refits, strict=True)]
    rivals += [scattered_rival(before, it, walkers.get(it.term.key), tempering) for it in proposals]
    rivals += [unnamed_rival(before, it, made, tempering) for it, made in zip(structures, terms, strict=True)]
    ordered, nothing = judged(rivals)
    kept = (*ordered[:1], *(rival.bare() for rival in ordered[1:]))
    return Round(before.point.bare(), kept, nothing, tuple(screened), null, tempering)


def _hopeless(before: Refit, refits: Sequence[Refit]) -> float:
    """Deviance beyond which a candidate is not fitted to the end: another gained more than twice as much."""
    best = min([before, *refits], key=lambda it: it.deviance)
    half = 0.5 * (before.deviance - best.deviance)
    return before.deviance - half if half > _FAR * best.tempering else math.inf


def _worth_a_refit(
    screened: list[Screened], also: Collection[tuple[str, str]], strict: list[Screened]
) -> list[Screened]:
    """The best of the screening, those asked for, and what explains how a wheel turns that is lost."""
    worth = _shortlist(screened, _REFITTED)
    asked = [next(it for it in screened if it.candidate.term.key == key) for key in also]
    for it in [*asked, *strict]:
        if it.candidate.term.key not in [other.candidate.term.key for other in worth]:
            worth.append(it)
    return worth


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


def _strict(before: Refit, reject: Collection[str]) -> list[Screened]:
    """What explains how a wheel turns that is lost.

    A wheel that turns another way than the model's passes for one that wanders, and what makes it turn so has
    nothing to explain: it has where only the declared wandering is allowed.
    """
    problem, weights = before.point.problem, before.point.weights
    believed = {node.name: declared_walk(problem, node) for node in problem.nodes if node.on_wheel}
    if all(weights.walks[name] <= _LOST * walk for name, walk in believed.items()):
        return []
    strict = screen(replace(before.point, weights=replace(weights, walks=believed))).candidates
    return _shortlist([it for it in strict if it.candidate.name not in reject], _STRICT)


def _strictest(weights: Weights, walks: Sequence[Mapping[str, float]]) -> Weights:
    """Weights for all candidates: wheels that wander as little as under the best of them."""
    least = {node: min(walk, *(own[node] for own in walks)) for node, walk in weights.walks.items()}
    return replace(weights, walks=least)


def _scattered(before: Refit, reject: Collection[str]) -> tuple[list[Proposal], dict[tuple[str, str], Refit]]:
    """What shows in scatter; and those that wander, refitted."""
    residuals = list(before.point.mean_residuals.values())
    proposals = [it for one_look in LOOKS for it in one_look(residuals) if it.term.effect.name not in reject]
    wander = [it for it in proposals if it.term.effect.random_walk_variance_rate() > 0.0]
    return proposals, {it.term.key: _with(before, it, rounds=0) for it in wander}


def _with(before: Refit, found: Proposal | Structure, rounds: int) -> Refit:
    return refit(before.point.at(before.state.with_term(found.term)), rounds).bare()
