"""Search for small effects: a finished search continues under weights with the correlation of the noise.

Those weights are estimated from residuals. While a large effect is missing, they would take it for noise, so
the search with white weights comes first. Where the residuals hold a structure that no known effect
explains, as those of most real roads do, any effect that resembles it would be named: then the result without
small effects stands.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.demands import CONSISTENT_SURPRISE, MIN_CORRELATED_GAIN
from hubodo.gap.judge.round import Round
from hubodo.gap.judge.search import SearchObserver, SearchResult, is_worse
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.refit import refit_with_weights

# Largest number of small effects; more of them are parts of an unknown structure. A model that lacked more
# effects than this is not known well enough for small ones.
_MAX_SMALL_EFFECTS, _MAX_LARGE_EFFECTS = 2, 4
# Smallest share of the decrease of the gap that the new weights have to preserve.
_MIN_EXPLAINED_SHARE = 0.8
# Fraction of the reported progress at which this step starts.
_PROGRESS_START = 0.7


def search_small_effects(
    result: SearchResult, reject: Collection[str] = (), observer: SearchObserver | None = None
) -> SearchResult:
    """Add effects that only show with the correlation of the noise; return `result` if none explains it.

    reject: effects not considered
    """
    observer = observer or SearchObserver()
    added = [term for term in result.final.state.terms if term.is_fitted]
    if len(added) > _MAX_LARGE_EFFECTS or any(term.effect.name.startswith(PREFIX) for term in added):
        # An unnamed term is a structure that no effect explains.
        return result
    state = replace(result.final.state, has_correlated_noise=True)
    fit = refit_with_weights(state).without_cache()
    if not fit.evaluation.weights.is_correlated:
        return result
    rounds = list(result.rounds)
    for number in range(_MAX_SMALL_EFFECTS + 1):
        judged = observer.journal.judge_round(
            fit.evaluation,
            reject,
            report_progress=lambda words, _: observer.report_progress(
                f"small effects: {words}", _PROGRESS_START
            ),
        )
        rounds.append(judged)
        best = judged.best
        if best is None:
            is_better = _is_explained(judged) and not _explains_less(result, fit)
            return replace(result, rounds=tuple(rounds), final=fit) if is_better else result
        if number == _MAX_SMALL_EFFECTS:
            break
        attempt = refit_with_weights((best.state or fit.state).with_term(best.term)).without_cache()
        if best.term.is_refittable and is_worse(fit, attempt):
            break
        fit = attempt
    return result


def _explains_less(result: SearchResult, fit: Refit) -> bool:
    """Return True if a fit loses much of what the effects of a search explain.

    Weights from residuals beside an effect may hide a part of it, such as the slow end of a warm-up.
    """
    before, white, correlated = (
        compute_gap(one.without_cache().residuals)
        for one in (result.rounds[0].evaluation, result.final.evaluation, fit.evaluation)
    )
    return before - correlated < _MIN_EXPLAINED_SHARE * (before - white)


def _is_explained(judged: Round) -> bool:
    """Return True if no known effect resembles what is left, apart from chance.

    Lines of vibration, which unnamed terms show, resemble no effect.
    """
    return not any(
        one.surprise >= CONSISTENT_SURPRISE
        and one.held_out_total > MIN_CORRELATED_GAIN
        and not one.term.effect.name.startswith(PREFIX)
        for one in judged.hypotheses
    )
