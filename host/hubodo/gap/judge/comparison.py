"""Comparison of the hypotheses of a round: substitutes, unnamed terms, fewest coordinates, equal scopes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.demands import (
    CONSISTENT_SURPRISE,
    MIN_CORRELATED_GAIN,
    MIN_CORRELATED_TEMPERING,
    MIN_HELD_OUT_Z,
)
from hubodo.gap.judge.hypothesis import DOUBTFUL_LEVEL, Hypothesis
from hubodo.gap.refit.cross_validation import compare_gains
from hubodo.gap.refit.prune import MODEL_IMPRECISION
from hubodo.gap.state.terms import ALL

# Chosen, and judged together with the other settings of the search, by `make gap-matrix`.
# Gain of a smooth drift over that of a random walk, from which on the walk follows a drift and noise.
_MIN_SMOOTH_ADVANTAGE = 4.0
# Ratio of the gain of an unnamed term to that of the best listed effect, below which it is that effect: in
# independent and in correlated residuals.
_MIN_UNNAMED_ADVANTAGE = (1.2, 2.0)
# Gain in ln likelihood, tempered, that a hypothesis has to have for each of its coordinates, where residuals
# are so correlated.
_COORDINATE_PENALTY = 10.0
# ln prior odds of an effect in one node over the same value in all.
_COINCIDENCE_NATS = math.log(2.0)


def prefer_simple(ordered: tuple[Hypothesis, ...], tempering: float) -> tuple[Hypothesis, ...]:
    """Put the hypothesis first whose determined coordinates gain most, less a penalty for their number.

    Where residuals are correlated, any further coordinate can absorb some of the road's irregularities. If
    gains differ by less than the penalty of one coordinate, the more probable hypothesis is preferred. Of
    several scopes of that effect with equal gains on held-out samples, the one with the largest likelihood
    and prior is preferred: a node with late samples rather than another with early ones. The two hypotheses
    exchange their probabilities.
    """
    if not ordered or ordered[0].state is None or tempering < MIN_CORRELATED_TEMPERING:
        return ordered

    penalty = _COORDINATE_PENALTY * tempering
    first = ordered[0]
    gains = {
        k: one.determined_gain - penalty * one.n_determined
        for k, one in enumerate(ordered)
        if not one.objection and one.state is not None
    }
    best_gain = max(gains.values(), default=0.0)
    chosen = next((k for k, gain in gains.items() if gain > best_gain - penalty), 0)
    chosen = max(
        _list_equal_scopes(ordered, chosen, tempering),
        key=lambda k: _score_scope(ordered[k], tempering),
        default=chosen,
    )
    result = list(ordered)
    result[0] = replace(ordered[chosen], probability=first.probability)
    if chosen:
        result[chosen] = replace(first, probability=ordered[chosen].probability)
    return share_between_scopes(result, tempering)


def _score_scope(one: Hypothesis, tempering: float) -> float:
    """Return ln likelihood and prior of a hypothesis, for the comparison of scopes of one effect.

    That all nodes have the same value of an effect of their own would be a coincidence.
    """
    is_coincidence = one.term.scope == ALL and one.term.effect.level == "node"
    log_prior = -one.term.effect.neg_log_prior() - (_COINCIDENCE_NATS if is_coincidence else 0.0)
    return one.determined_gain / tempering + log_prior


def share_between_scopes(ordered: Sequence[Hypothesis], tempering: float) -> tuple[Hypothesis, ...]:
    """Divide the probability of the first hypothesis among scopes with equal gain on held-out samples.

    A speed measured by two wheels, for example, shows only the difference of their clocks, and either may be
    wrong. The scopes share in proportion to their priors.
    """
    scopes = _list_equal_scopes(ordered, 0, tempering)
    if len(scopes) < 2:
        return tuple(ordered)
    priors = {k: math.exp(-ordered[k].term.effect.neg_log_prior()) for k in scopes}
    total = sum(ordered[k].probability for k in scopes) / sum(priors.values())
    return tuple(
        replace(one, probability=total * priors[k]) if k in priors else one for k, one in enumerate(ordered)
    )


def _list_equal_scopes(hypotheses: Sequence[Hypothesis], index: int, tempering: float) -> list[int]:
    """Return the scopes of the effect of one hypothesis that gain most on held-out samples."""
    one = hypotheses[index]
    scopes = [
        k
        for k, other in enumerate(hypotheses)
        if other.term.effect.name == one.term.effect.name
        and other.n_determined == one.n_determined
        and other.state is not None
        and not other.objection
    ]
    best = max((hypotheses[k] for k in scopes), key=lambda other: other.held_out_total, default=one)
    return [k for k in scopes if not _is_better_scope(best, hypotheses[k], tempering)]


def _is_better_scope(best: Hypothesis, other: Hypothesis, tempering: float) -> bool:
    """Return True if the scope of one hypothesis is better than another of as many coordinates.

    Its advantage exceeds what a varying noise level could produce, or it has one in nearly all folds, whose
    level is the same for both, and more than correlation or an imprecise model leave in doubt.
    """
    if best.held_out_total - other.held_out_total > best.doubtful_gain:
        return True
    if best.held_out_gain is None or other.held_out_gain is None:
        return False
    advantage, z = compare_gains(best.held_out_gain, other.held_out_gain)
    doubt = max(MIN_CORRELATED_GAIN * tempering, MODEL_IMPRECISION**2 * best.gain)
    return advantage > doubt and z > MIN_HELD_OUT_Z


def object_to_substitutes(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Reject offsets and clocks that gain less than a doubtful property of the vehicle.

    Unnamed terms with many coordinates always gain something, and say nothing about offsets.
    """
    doubtful = [
        one.held_out_total
        for one in hypotheses
        if one.objection == DOUBTFUL_LEVEL and not one.term.effect.name.startswith(PREFIX)
    ]
    return [
        one.with_objection("gains less than an effect that is in doubt")
        if one.is_within_level and not one.objection and one.held_out_total < max(doubtful, default=0.0)
        else one
        for one in hypotheses
    ]


def object_to_walks(hypotheses: Sequence[Hypothesis], tempering: float) -> list[Hypothesis]:
    """Reject random walks that gain no more than an effect on which the parts of the log agree.

    Where residuals are correlated, a walk follows an error that turns with the wheel as well as noise. A walk
    would not give the same misalignment in each part. There it is a smooth drift, such as a warm-up, as soon
    as that gains more; in white noise the drift also has to pay for its parameters.
    """
    if tempering <= MIN_CORRELATED_TEMPERING:
        return list(hypotheses)
    steady = [one.gain for one in hypotheses if not one.objection and one.surprise >= CONSISTENT_SURPRISE]
    best_gain = max(steady, default=0.0)
    return [
        one.with_objection("gains no more than an effect on which the parts of the log agree")
        if one.term.effect.random_walk_variance_rate() > 0.0 and (one.gain < best_gain or _is_smooth(one))
        else one
        for one in hypotheses
    ]


def _is_smooth(walk: Hypothesis) -> bool:
    """Return True if a smooth drift gains more than a random walk."""
    return walk.proposal is not None and walk.proposal.smooth_advantage > _MIN_SMOOTH_ADVANTAGE


def drop_similar_unnamed(hypotheses: Sequence[Hypothesis], tempering: float) -> list[Hypothesis]:
    """Leave out unnamed terms that gain hardly more than a listed effect.

    On a road no model fits exactly, so the more flexible of two similar models always gains more.
    """
    is_correlated = tempering > MIN_CORRELATED_TEMPERING
    named = [
        one.gain
        for one in hypotheses
        if (is_correlated or not one.objection) and not one.term.effect.name.startswith(PREFIX)
    ]
    minimum = _MIN_UNNAMED_ADVANTAGE[is_correlated] * max(named, default=0.0)
    return [one for one in hypotheses if not one.term.effect.name.startswith(PREFIX) or one.gain > minimum]
