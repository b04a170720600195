"""Second thoughts: each name that was found is judged again beside all the others, and against chance."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from math import log

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.rival import Rival
from hubodo.gap.judge.round import DECIDED, EMPIRICAL, Round
from hubodo.gap.judge.search import SearchResult, Watch
from hubodo.gap.refit.refit import Refit, gain_over, refit, refit_with_weights
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm

# Names replaced at most: two that take each other's place would go on for ever.
_TIMES = 3
# Of more names than so many only those are looked at again that were added on trial, that have lost half of
# what they gained when they were found, that were found beside one that has left, or that are no names but
# terms of a library: a turn costs a round for each.
_MANY, _LEFT = 4, 0.5
# Names at most that are tried together in the place of a walk.
_DRIFTS = 3
# Of the progress, where this begins, and what it is.
_FROM, _SHARE = 0.75, 0.15

Rounds = Mapping[tuple[str, str], Round]
"""By effect and scope, the round that judged it."""


def reconsider(
    found: SearchResult,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    watch: Watch | None = None,
) -> tuple[SearchResult, Rounds]:
    """Each effect that was found is taken out and looked for again beside all the others.

    What came in as a proxy for something that was found later leaves; what has a better rival is replaced.
    accept: names that stay all the same, as sure as they are. reject: names not considered.
    """
    names = _Names(found.final, {made.best.label: made for made in found.rounds if made.best is not None})
    keys = [term.key for term in names.terms]
    if len(keys) == 1 and keys[0] in names.as_found and not found.decimated and not accept:
        # Alone it was judged beside all the others already.
        return found, {keys[0]: names.as_found[keys[0]]}
    doubts = _Doubts(accept, reject, watch or Watch())
    rounds, changed = doubts.turn(names)
    while changed is not None:
        names = changed
        rounds, changed = doubts.turn(names)
    for key, made in rounds.items():
        if made.rival(key) is None and key[0] not in accept:
            # Others of its kind took its place among the rivals: it counts as it was found.
            rounds[key] = names.as_found.get(key, made)
    return replace(found, final=names.final), rounds


@dataclass(frozen=True)
class _Names:
    """The names as they stand. final: their fit. as_found: of each that was the best of a round, that round.

    replaced: how often others took the place of one.
    """

    final: Refit
    as_found: Rounds
    replaced: int = 0

    @property
    def terms(self) -> list[ModelTerm]:
        return [term for term in self.final.state.terms if term.fitted]

    def without(self, term: ModelTerm) -> State:
        """The model as it is, but for one name."""
        return self.final.state.afresh([it for it in self.final.state.terms if it.key != term.key])

    def replaced_by(self, final: Refit, more: Rounds) -> _Names:
        """With others in the place of one: their fit, and the rounds in which they were found."""
        return _Names(final, {**self.as_found, **more}, self.replaced + 1)

    def settled(self) -> dict[tuple[str, str], Round]:
        """The names that stay as they were when they were found, each with its round."""
        if len(self.terms) <= _MANY:
            return {}
        return {term.key: self.as_found[term.key] for term in self.terms if self._as_good(term)}

    def _as_good(self, term: ModelTerm) -> bool:
        """Whether a name is worth what it was, beside what it was found beside."""
        made = self.as_found.get(term.key)
        own = None if made is None else made.rival(term.key)
        if made is None or own is None or not term.moves or term.effect.name.startswith(PREFIX):
            return False
        if not {it.key for it in made.before.state.terms} <= {it.key for it in self.final.state.terms}:
            # It was judged beside what is not there: what that one left to others was not what there is.
            return False
        left = gain_over(refit(self.final.point.at(self.without(term)), rounds=2), self.final)
        return left > _LEFT * own.gain


@dataclass(frozen=True)
class _Doubts:
    """Looks at names again. accept, reject: see `reconsider`."""

    accept: Collection[str]
    reject: Collection[str]
    watch: Watch

    def turn(self, names: _Names) -> tuple[dict[tuple[str, str], Round], _Names | None]:
        """One name after the other, until one does not stay: their rounds, and the names then.

        None where all of them stay.
        """
        rounds = names.settled()
        doubted = [term for term in names.terms if term.key not in rounds]
        for k, term in enumerate(doubted):
            part = (names.replaced + k / len(doubted)) / (_TIMES + 1)
            self.watch.say(f"reconsidering {term.words}", _FROM + _SHARE * min(part, 1.0))
            rounds[term.key] = made = self._look_for(term, names)
            changed = self._judged(term, names, made)
            if changed is not None:
                return rounds, changed
        return rounds, None

    def _look_for(self, term: ModelTerm, names: _Names) -> Round:
        """What is missing where a name is not there."""
        also = [term.key] if term.moves and term.effect.name in self.accept else []
        return self.watch.journal.look(names.final.point.at(names.without(term)), self.reject, also)

    def _judged(self, term: ModelTerm, names: _Names, made: Round) -> _Names | None:
        """The names after a round without one of them; None where it stays."""
        best = made.best
        if term.effect.name in self.accept:
            return None
        if best is None:
            return replace(names, final=refit_with_weights(names.without(term)))
        if names.replaced == _TIMES:
            # The round only says how sure the name is.
            return None
        if best.label != term.key:
            without = names.without(term)
            final = refit_with_weights(without.with_terms([*without.terms, best.term]))
            return names.replaced_by(final, {best.label: made})
        if best.term.effect.random_walk_variance_rate() <= 0.0:
            return None
        several = _together(made, best, {*self.reject, term.effect.name, EMPIRICAL}, self.watch)
        return None if several is None else names.replaced_by(*several)


def _together(made: Round, walk: Rival, reject: Collection[str], watch: Watch) -> tuple[Refit, Rounds] | None:
    """Names that explain together what passed for a walk, where they are more probable than it; their rounds.

    A walk can pass for any slow drifts at once; of the names that make them each explains its own alone.
    """
    if walk.proposal is None:
        return None
    current, rounds = _in_place_of_a_walk(made, reject, watch)
    if len(rounds) < 2:
        # Each name alone was its rival before.
        return None
    chosen, cost = log(2.0 * len(BY_NAME)), 0.0
    for further in rounds.values():
        assert further.best is not None
        cost += further.best.gain / further.tempering - further.best.evidence + chosen
    before = refit(current.point.at(made.before.state))
    walker = refit(before.point.at(before.state.with_term(walk.term)), rounds=0)
    several = gain_over(before, current) / current.tempering - cost
    alone = gain_over(before, walker) / current.tempering - (walk.proposal.gain - walk.proposal.evidence)
    return (current, rounds) if several > alone - chosen else None


def _in_place_of_a_walk(made: Round, reject: Collection[str], watch: Watch) -> tuple[Refit, Rounds]:
    """The fit of the names that are found, one after the other, where it was; and their rounds."""
    current, rounds = refit(made.before), dict[tuple[str, str], Round]()
    while len(rounds) < _DRIFTS:
        further = watch.journal.look(current.point, reject)
        best = further.best
        if best is None or best.state is None:
            break
        rounds[best.label] = further
        current = refit_with_weights(best.state.with_term(best.term)).bare()
    return current, rounds


def beyond_chance(
    found: SearchResult, rounds: Rounds, accept: Collection[str] = ()
) -> tuple[SearchResult, Rounds]:
    """Without what the best of all candidates would gain by chance, in what the finished model leaves.

    Only of effects that show in the mean; accept: names that stay all the same.
    """
    null = found.rounds[-1].null
    by_chance = set()
    for key, made in rounds.items():
        own = made.rival(key)
        if own is not None and own.state is not None and own.p_value(null) >= 1.0 - DECIDED:
            by_chance.add(key)
    kept = [it for it in found.final.state.terms if it.key not in by_chance or it.effect.name in accept]
    if len(kept) == len(found.final.state.terms):
        return found, rounds
    return replace(found, final=refit_with_weights(found.final.state.afresh(kept))), rounds
