"""Removal of effects that small changes of the model's own effects explain nearly as well."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.hypothesis import is_within_level
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.linear.directions import directions_of_terms
from hubodo.gap.linear.linearisation import linearise
from hubodo.gap.refit.cross_validation import compute_held_out_gain
from hubodo.gap.refit.refit import Refit, linearise_fit, refit, refit_with_weights
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm

# 1 sigma, in usual sizes, by which an effect of the vehicle differs from one drive to the next: a mounting of
# 20 mrad by 2 mrad, a lever arm of 10 mm by 1 mm. On a real car misalignments differed by 0.7 mrad.
REPEATABILITY = 0.1
# Largest change that counts as repeatability, in units of its sigma.
_MAX_CHANGE_SIGMA = 2.0
# Tempering from which on residuals are so correlated that a small change looks like a new effect.
_MIN_TEMPERING = 2.0


def drop_effects_within_repeatability(
    result: SearchResult, accept: Collection[str] = ()
) -> tuple[SearchResult, tuple[ModelTerm, ...]]:
    """Drop new effects that gain too little over a model whose effects may change by their repeatability.

    accept: effects that are never dropped

    A misalignment that changed by 1 mrad between two drives leaves a residual that a new effect may explain,
    with a gain far above that of white noise. Returns the result and the dropped terms.
    """
    final = result.final
    if final.tempering < _MIN_TEMPERING or not any(not term.is_fitted for term in final.state.terms):
        return result, ()
    adapted = _adapt(final, final.state)
    dropped = [
        term
        for term in final.free_terms
        if term.effect.name not in accept
        and _is_new_property(term, final.state)
        and _gains_too_little(final, adapted, term)
    ]
    if not dropped:
        return result, ()
    state = final.state.without_terms([term.key for term in dropped])
    return replace(result, final=refit_with_weights(state)), tuple(dropped)


def _adapt(final: Refit, state: State) -> Refit:
    """Return a fit of a state in which the effects of the model file may change by their repeatability.

    An effect that would change by more than its repeatability is held at its value.
    """
    terms = [
        term if term.is_fitted else replace(term, is_fitted=True, repeatability=REPEATABILITY)
        for term in state.terms
    ]
    evaluation = refit(final.evaluation.with_state(state), rounds=0).evaluation
    evaluation = evaluation.with_state(evaluation.state.with_terms(terms))
    free_terms = [term for term in terms if term.is_refittable]
    linearisation = linearise(evaluation, directions_of_terms(evaluation.problem, free_terms, terms)[0])
    fit = linearise_fit(evaluation, linearisation)
    for _ in range(len(free_terms)):
        excess = {term.key: _excess(fit, term) for term in fit.free_terms}
        key = max(excess, key=lambda key: excess[key])
        if excess[key] <= 1.0:
            break
        terms = [_freeze(term) if term.key == key else term for term in terms]
        fit = linearise_fit(evaluation.with_state(evaluation.state.with_terms(terms)), linearisation)
    return fit.without_cache()


def _excess(fit: Refit, term: ModelTerm) -> float:
    """Return the largest change of a coordinate of a given term, relative to its repeatability."""
    if not term.repeatability:
        return 0.0
    change = np.abs(fit.step[fit.coordinate_slice(term)]).max(initial=0.0)
    return float(change / (_MAX_CHANGE_SIGMA * term.repeatability))


def _freeze(term: ModelTerm) -> ModelTerm:
    return replace(term, frozen=tuple(range(len(term.effect.coordinates()))))


def _gains_too_little(final: Refit, adapted: Refit, term: ModelTerm) -> bool:
    without = _adapt(final, final.state.without_terms([term.key]))
    return is_within_level(term, compute_held_out_gain(without.fold_deviances, adapted.fold_deviances))


def _is_new_property(term: ModelTerm, state: State) -> bool:
    """Return True if a term is a property of the vehicle that the model file does not have."""
    if term.effect.name.startswith(PREFIX) or term.effect.varies_between_drives:
        return False
    return term.effect.name not in [item.effect.name for item in state.problem.model.effects]
