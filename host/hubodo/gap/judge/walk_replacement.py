"""Several effects in place of a random walk, which can imitate them together."""

from __future__ import annotations

from collections.abc import Collection
from math import log

from hubodo.effects import count_fitted_effects
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.round import Round, RoundsByKey
from hubodo.gap.judge.search import SearchObserver
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.refit import compute_gain, refit, refit_with_weights

# Largest number of effects that are tried together instead of a random walk.
_MAX_WALK_REPLACEMENTS = 3


def replace_walk(
    judged: Round, walk: Hypothesis, reject: Collection[str], observer: SearchObserver
) -> tuple[Refit, RoundsByKey] | None:
    """Return several effects that together are more probable than a random walk, with their rounds, or None.

    A walk can imitate several slow drifts at once, of which each effect explains only its own.
    """
    if walk.proposal is None:
        return None
    fit, rounds = _fit_without_walk(judged, reject, observer)
    if len(rounds) < 2:
        # Each effect alone was already compared with the walk.
        return None
    selection_cost, cost = log(2.0 * count_fitted_effects()), 0.0
    for judged_further in rounds.values():
        assert judged_further.best is not None
        cost += (
            judged_further.best.gain / judged_further.tempering
            - judged_further.best.evidence
            + selection_cost
        )
    before = refit(fit.evaluation.with_state(judged.evaluation.state))
    walk_fit = refit(before.evaluation.with_state(before.state.with_term(walk.term)), rounds=0)
    evidence_of_several = compute_gain(before, fit) / fit.tempering - cost
    evidence_of_walk = compute_gain(before, walk_fit) / fit.tempering - (
        walk.proposal.gain - walk.proposal.evidence
    )
    return (fit, rounds) if evidence_of_several > evidence_of_walk - selection_cost else None


def _fit_without_walk(
    judged: Round, reject: Collection[str], observer: SearchObserver
) -> tuple[Refit, RoundsByKey]:
    """Add up to three effects in place of the walk; return their fit and their rounds."""
    fit, rounds = refit(judged.evaluation), dict[tuple[str, str], Round]()
    while len(rounds) < _MAX_WALK_REPLACEMENTS:
        judged_further = observer.journal.judge_round(fit.evaluation, reject)
        best = judged_further.best
        if best is None or best.state is None:
            break
        rounds[best.key] = judged_further
        fit = refit_with_weights(best.state.with_term(best.term)).without_cache()
    return fit, rounds
