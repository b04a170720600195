"""Reasons to doubt a finding: another cause or formula would leave nearly the same residual."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.effects.plausibility import implausible_parameters
from hubodo.gap.explain.result import Estimate
from hubodo.gap.judge.demands import CONSISTENT_SURPRISE, MIN_CORRELATED_TEMPERING, MIN_WHITENED_Z
from hubodo.gap.judge.hypothesis import DOUBTFUL_CORRELATION, DOUBTFUL_LEVEL, UNHELPFUL, Hypothesis
from hubodo.gap.judge.posterior import MAX_SIMILAR_GAIN
from hubodo.gap.judge.round import RoundsByKey
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.state.terms import ALL, ModelTerm

# An unnamed term on the same nodes that gains this many times as much can imitate an effect.
_MIN_UNNAMED_GAIN_RATIO = 1.0
# Sigmas, by the jackknife, below which the parts of a log do not agree on an effect.
_MIN_AGREEMENT_SIGMAS = 3.0
# Blocks of some four seconds that show the correlation of uneven noise; half a drive has 16. With fewer,
# an effect must gain this many sigma of the level of the noise.
_MIN_UNEVEN_BLOCKS, _MIN_LEVEL_SIGMAS = 12, 3.0
# Share of the gain of a random walk from which on an effect of the mean is as good an explanation.
_MIN_IMITATED_SHARE = 0.9
# Parameter that is the shape of a drift, and how many sigmas determine it.
_SHAPE_PARAMETER, _MIN_SHAPE_SIGMAS = "time_constant", 3.0


def is_doubted(
    term: ModelTerm,
    own: Hypothesis | None,
    hypotheses: Sequence[Hypothesis],
    parameters: Mapping[str, Estimate],
    result: SearchResult,
    rounds: RoundsByKey,
) -> bool:
    """Return True if another cause or formula would leave nearly the same residual.

    own, hypotheses: that of the finding, and all of its round
    """
    if term.effect.name.startswith(PREFIX):
        # The structure is there, but a formula with the spin fits about as well as one with its square.
        return True
    if implausible_parameters(term.effect):
        # The fit wants more than is plausible.
        return True
    is_correlated = (
        result.final.state.has_correlated_noise or result.rounds[-1].tempering > MIN_CORRELATED_TEMPERING
    )
    return (
        _is_contested(own, hypotheses)
        or _is_imitated(own, hypotheses)
        or _is_beside_walk(term, parameters, result)
        or _is_hardly_repeated(own, result.final)
        or (is_correlated and (_is_inconsistent(own) or _is_shapeless(parameters)))
        or _is_overshadowed(term, result, rounds)
    )


def widen_sigmas_by_doubtful_effects(
    term: ModelTerm, parameters: Mapping[str, Estimate], hypotheses: Sequence[Hypothesis]
) -> dict[str, Estimate]:
    """Return parameters whose sigma contains the change by effects that were left out because of doubt.

    An effect that all parts of the log confirm may gain less than a varying noise level could produce. If it
    is there after all, other effects have other values: a scale error left out looks like a bias of the gyro.

    hypotheses: of the last round
    """
    states = [one.state for one in hypotheses if one.state is not None and _is_left_out(one)]
    others = [own.effect.values() for state in states for own in state.terms if own.key == term.key]
    widened = {}
    for name, estimate in parameters.items():
        shift = max((abs(values[name] - estimate.value) for values in others), default=0.0)
        sigma = None if estimate.sigma is None else math.hypot(estimate.sigma, shift)
        widened[name] = replace(estimate, sigma=sigma)
    return widened


def _is_left_out(one: Hypothesis) -> bool:
    """Return True if parts of the log agree on an effect that noise could produce, and that was left out."""
    return (
        one.objection in (DOUBTFUL_LEVEL, DOUBTFUL_CORRELATION)
        and one.surprise >= CONSISTENT_SURPRISE
        and one.held_out_gain is not None
        and one.held_out_gain.z >= MIN_WHITENED_Z
        and not one.term.effect.name.startswith(PREFIX)
    )


def _is_contested(own: Hypothesis | None, hypotheses: Sequence[Hypothesis]) -> bool:
    """Return True if a listed effect with as few coordinates fits as well, but fails on held-out samples.

    A clock that drifts is visible at the end of a log alone, which the other folds do not predict.
    """
    if own is None or own.held_out_gain is None:
        return False
    return any(
        other.objection == UNHELPFUL
        and not other.term.effect.name.startswith(PREFIX)
        and other.term.effect.name != own.term.effect.name
        and other.gain > own.gain - MAX_SIMILAR_GAIN
        and len(other.term.effect.coordinates()) <= len(own.term.effect.coordinates())
        for other in hypotheses
    )


def _is_imitated(own: Hypothesis | None, hypotheses: Sequence[Hypothesis]) -> bool:
    """Return True for a random walk of a gyro that an effect of the mean explains nearly as well.

    A walk follows slow noise too, and therefore gains more than the temperature if that is the cause.
    """
    return (
        own is not None
        and own.term.effect.random_walk_variance_rate() > 0.0
        and any(
            one.held_out_gain is not None and not one.objection and one.gain > _MIN_IMITATED_SHARE * own.gain
            for one in hypotheses
        )
    )


def _is_beside_walk(term: ModelTerm, parameters: Mapping[str, Estimate], result: SearchResult) -> bool:
    """Return True for a drift of a gyro whose bias walks as well: it may be a part of the walk."""
    return _is_drift(parameters) and any(
        other.effect.random_walk_variance_rate() > 0.0
        and (other.scope == term.scope or ALL in (other.scope, term.scope))
        for other in result.final.state.terms
    )


def _is_hardly_repeated(own: Hypothesis | None, final: Refit) -> bool:
    """Return True if a short log of uneven noise shows an effect by less than its level leaves in doubt.

    Few stretches neither show how correlated the residuals are nor contain the same manoeuvre twice.
    """
    gain = None if own is None else own.held_out_gain
    is_short = final.min_tempering > 1.0 and len(final.block_scores) < _MIN_UNEVEN_BLOCKS
    return gain is not None and is_short and gain.total < _MIN_LEVEL_SIGMAS * gain.level_sigma


def _is_inconsistent(own: Hypothesis | None) -> bool:
    """Return True if the parts of a log do not agree on an effect.

    A warm-up follows a random walk of the bias, but without any part of it, the others give another warm-up.
    """
    return own is not None and own.held_out_gain is not None and own.agreement_sigmas < _MIN_AGREEMENT_SIGMAS


def _is_overshadowed(term: ModelTerm, result: SearchResult, rounds: RoundsByKey) -> bool:
    """Return True if an unnamed term on the same nodes has a much larger gain."""
    terms = [other for other in result.final.state.terms if other.is_fitted]
    nodes = result.final.state.problem.nodes
    scopes = [term.scope, *(node.name for node in nodes if term.scope == ALL)]
    return any(
        other.effect.name.startswith(PREFIX)
        and other.scope in scopes
        and _gain_of(rounds, other) > _MIN_UNNAMED_GAIN_RATIO * _gain_of(rounds, term)
        for other in terms
    )


def _is_shapeless(parameters: Mapping[str, Estimate]) -> bool:
    """Return True if the time constant of a drift is not determined.

    Any slow drift looks like one with a time constant as long as the log, a random walk of a gyro as well.
    """
    if not _is_drift(parameters):
        return False
    shape = parameters[_SHAPE_PARAMETER]
    return shape.value < _MIN_SHAPE_SIGMAS * (shape.sigma or np.inf)


def _is_drift(parameters: Mapping[str, Estimate]) -> bool:
    """Return True for the parameters of a drift with sizes and a time constant."""
    return len(parameters) > 1 and _SHAPE_PARAMETER in parameters


def _gain_of(rounds: RoundsByKey, term: ModelTerm) -> float:
    judged = rounds.get(term.key)
    own = None if judged is None else judged.find_hypothesis(term.key)
    return 0.0 if own is None else own.gain
