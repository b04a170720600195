"""Reconsideration: each added effect is judged again with all others in the model."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.round import EMPIRICAL, Round, RoundsByKey
from hubodo.gap.judge.search import SearchObserver, SearchResult
from hubodo.gap.judge.walk_replacement import replace_walk
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.refit import compute_gain, refit, refit_with_weights
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm

# Largest number of replacements; each costs a round for every effect.
_MAX_REPLACEMENTS = 6
# With more effects than this, only those are reconsidered that were added provisionally, lost half of their
# gain, were added next to an effect that has been removed since, or are library terms: each costs one round.
_MAX_FULL_RECONSIDERATION, _MIN_GAIN_SHARE = 4, 0.5
# Start and fraction of the reported progress for this step.
_RECONSIDER_PROGRESS_START, _RECONSIDER_PROGRESS_SHARE = 0.75, 0.15


def reconsider_effects(
    result: SearchResult,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    observer: SearchObserver | None = None,
    settled: RoundsByKey | None = None,
) -> tuple[SearchResult, RoundsByKey]:
    """Remove each effect in turn and search again with all others in the model.

    Effects that imitated later ones are dropped, and those with a better alternative are replaced.

    accept: effects that are never removed
    reject: effects not considered
    settled: effects that are not reconsidered, with the rounds that judged them
    """
    settled = settled or {}
    effects = _EffectSet(
        result.final,
        {judged.best.key: judged for judged in result.rounds if judged.best is not None} | {**settled},
        settled=frozenset(settled),
        is_search_complete=not result.used_decimation and not accept,
    )
    reconsideration = _Reconsideration(accept, reject, observer or SearchObserver())
    rounds, revised = reconsideration.run_pass(effects)
    while revised is not None:
        effects = revised
        rounds, revised = reconsideration.run_pass(effects)
    for key, judged in rounds.items():
        if judged.find_hypothesis(key) is None and key[0] not in accept:
            # Similar hypotheses displaced the effect from the shortlist, so its original round counts.
            rounds[key] = effects.original_rounds.get(key, judged)
    return replace(result, final=effects.final), rounds


@dataclass(frozen=True)
class _EffectSet:
    """The current set of effects.

    final: fit of all effects in the set
    original_rounds: the round that found each effect
    earlier: keys of the sets that this one replaced
    confirmed_rounds: rounds in which an earlier set confirmed an effect that is still there
    settled: keys of effects that are not reconsidered
    is_search_complete: True if the search used all samples in each round and tested each effect
    """

    final: Refit
    original_rounds: RoundsByKey
    earlier: tuple[frozenset[tuple[str, str]], ...] = ()
    confirmed_rounds: RoundsByKey = field(default_factory=dict)
    settled: frozenset[tuple[str, str]] = frozenset()
    is_search_complete: bool = False

    @property
    def n_replaced(self) -> int:
        return len(self.earlier)

    @property
    def keys(self) -> frozenset[tuple[str, str]]:
        return frozenset(term.key for term in self.terms)

    @property
    def terms(self) -> list[ModelTerm]:
        return [term for term in self.final.state.terms if term.is_fitted]

    def without(self, term: ModelTerm) -> State:
        """Return the model without one effect; a refined one returns to its value in the model file."""
        return self.final.state.without_terms([term.key])

    def replaced_by(self, final: Refit, rounds: RoundsByKey) -> _EffectSet:
        """Return the set with one effect replaced: its fit, and the rounds that found the new effects."""
        return replace(
            self,
            final=final,
            original_rounds={**self.original_rounds, **rounds},
            earlier=(*self.earlier, self.keys),
        )

    def confirmed_by(self, rounds: RoundsByKey) -> _EffectSet:
        """Return the set with the rounds of this pass in which the effect was the best hypothesis."""
        confirmed = {
            key: judged
            for key, judged in rounds.items()
            if judged.best is not None and judged.best.key == key
        }
        return replace(self, confirmed_rounds={**self.confirmed_rounds, **confirmed})

    def settled_rounds(self) -> dict[tuple[str, str], Round]:
        """Return the rounds of the effects that need no reconsideration."""
        rounds = {**self.original_rounds, **self.confirmed_rounds}
        is_small = len(self.terms) <= _MAX_FULL_RECONSIDERATION
        return {
            term.key: rounds[term.key]
            for term in self.terms
            if term.key in self.settled
            or self._was_judged_beside_all(term)
            or (not is_small and self._is_settled(term))
        }

    def _was_judged_beside_all(self, term: ModelTerm) -> bool:
        """Return True if all others, and no further effect, were in the model when an effect was added."""
        judged = self.original_rounds.get(term.key)
        if judged is None or not self.is_search_complete:
            return False
        if term.effect.is_process() and len(self.terms) > 1:
            # Several effects together may replace the walk.
            return False
        others = {other.key for other in judged.evaluation.state.terms if other.is_fitted}
        return others == self.keys - {term.key}

    def _is_settled(self, term: ModelTerm) -> bool:
        """Return True if an effect retains its gain, and all effects that preceded it are still in the set.

        For an effect that an earlier pass confirmed, the gain alone counts.
        """
        judged = self.confirmed_rounds.get(term.key) or self.original_rounds.get(term.key)
        own = None if judged is None else judged.find_hypothesis(term.key)
        if judged is None or own is None or not term.is_refittable or term.effect.name.startswith(PREFIX):
            return False
        present = {other.key for other in self.final.state.terms}
        if (
            term.key not in self.confirmed_rounds
            and not {other.key for other in judged.evaluation.state.terms} <= present
        ):
            # The effect was judged with an effect in the model that has been removed since.
            return False
        gain = compute_gain(refit(self.final.evaluation.with_state(self.without(term)), rounds=2), self.final)
        return gain > _MIN_GAIN_SHARE * own.gain


@dataclass(frozen=True)
class _Reconsideration:
    """Reconsideration of effects; `accept` and `reject` as in `reconsider_effects`."""

    accept: Collection[str]
    reject: Collection[str]
    observer: SearchObserver

    def run_pass(self, effects: _EffectSet) -> tuple[dict[tuple[str, str], Round], _EffectSet | None]:
        """Reconsider one effect after the other until one changes; return their rounds and the new set.

        The new set is None if all effects stay.
        """
        rounds = effects.settled_rounds()
        pending = [term for term in effects.terms if term.key not in rounds]
        for k, term in enumerate(pending):
            progress = (effects.n_replaced + k / len(pending)) / (_MAX_REPLACEMENTS + 1)
            self.observer.report_progress(
                f"reconsidering {term.label}",
                _RECONSIDER_PROGRESS_START + _RECONSIDER_PROGRESS_SHARE * min(progress, 1.0),
            )
            rounds[term.key] = judged = self._judge_without(term, effects)
            revised = self._revise(term, effects, judged)
            if revised is not None:
                return rounds, revised.confirmed_by(rounds)
        return rounds, None

    def _judge_without(self, term: ModelTerm, effects: _EffectSet) -> Round:
        """Judge a round for the model without one effect."""
        always_refit = [term.key] if term.is_refittable and term.effect.name in self.accept else []
        return self.observer.journal.judge_round(
            effects.final.evaluation.with_state(effects.without(term)), self.reject, always_refit
        )

    def _revise(self, term: ModelTerm, effects: _EffectSet, judged: Round) -> _EffectSet | None:
        """Return the new set after a round without one effect; None if it stays."""
        best = judged.best
        if term.effect.name in self.accept:
            return None
        if best is None:
            return replace(effects, final=refit_with_weights(effects.without(term)))
        if effects.n_replaced == _MAX_REPLACEMENTS:
            # The round only determines the probability of the effect.
            return None
        if best.key != term.key:
            if (effects.keys - {term.key}) | {best.key} in effects.earlier:
                # Two effects that replace each other would loop forever.
                return None
            without = effects.without(term)
            final = refit_with_weights(without.with_term(best.term))
            return effects.replaced_by(final, {best.key: judged})
        if not best.term.effect.is_process():
            return None
        replacement = replace_walk(judged, best, {*self.reject, term.effect.name, EMPIRICAL}, self.observer)
        return None if replacement is None else effects.replaced_by(*replacement)
