"""Effects that the residual of the final model would show by chance."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from hubodo.gap.judge.demands import (
    CONSISTENT_SURPRISE,
    MIN_CORRELATED_TEMPERING,
    chance_gain,
    helps_held_out,
    is_within_level,
)
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.round import MIN_ADD_PROBABILITY, Round, RoundsByKey
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.refit.refit import refit_with_weights


def drop_chance_effects(
    result: SearchResult, rounds: RoundsByKey, accept: Collection[str] = ()
) -> tuple[SearchResult, RoundsByKey]:
    """Drop effects whose gain the best of all candidates would reach by chance.

    The null distribution is that of the final model's residual. Applies to effects visible in the mean;
    `accept`: effects that are never removed.
    """
    last, by_chance = result.rounds[-1], set()
    for key, judged in rounds.items():
        hypothesis = judged.find_hypothesis(key)
        if hypothesis is None or hypothesis.state is None:
            continue
        # The largest gain by chance is that of the drifts, which correlated residuals imitate best.
        is_chance = (
            hypothesis.surprise < CONSISTENT_SURPRISE
            and hypothesis.p_value(last.null_distribution) >= 1.0 - MIN_ADD_PROBABILITY
        )
        if is_chance or _is_overfitted(hypothesis, judged, last):
            by_chance.add(key)
    dropped = [
        term.key
        for term in result.final.state.terms
        if term.is_fitted and term.key in by_chance and term.effect.name not in accept
    ]
    if not dropped:
        return result, rounds
    return replace(result, final=refit_with_weights(result.final.state.without_terms(dropped))), rounds


def _is_overfitted(hypothesis: Hypothesis, judged: Round, last: Round) -> bool:
    """Return True if the last round shows correlation under which an effect would not have been added.

    Where an effect is visible in a few blocks only, such as standstills between drives in vibration, its own
    block scores do not show that residuals are correlated: a warm-up passes through all of them.
    """
    gain = hypothesis.held_out_gain
    if gain is None or not judged.tempering <= MIN_CORRELATED_TEMPERING < last.tempering:
        return False
    doubtful = replace(gain, max_doubt=chance_gain(last.tempering, hypothesis.surprise))
    is_confirmed = helps_held_out(hypothesis.gain, gain, last.tempering)
    return not is_confirmed or is_within_level(hypothesis.term, doubtful)
