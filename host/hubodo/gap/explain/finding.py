"""Findings: an added effect with parameters, sigmas, confidence and alternatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import exp, isclose

import numpy as np

from hubodo.effects import Effect
from hubodo.effects.empirical import PREFIX
from hubodo.effects.plausibility import implausible_parameters
from hubodo.gap.explain.descriptions import describe_manoeuvre, describe_where
from hubodo.gap.explain.result import BeforeAfter, Estimate, Finding
from hubodo.gap.judge.hypothesis import MIN_CORRELATED_TEMPERING, UNHELPFUL, Hypothesis
from hubodo.gap.judge.posterior import MAX_SIMILAR_GAIN, sum_by_name
from hubodo.gap.judge.reconsider import RoundsByKey
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.residual import Residual, compute_gap
from hubodo.gap.refit.refit import Refit
from hubodo.gap.state.terms import ALL, ModelTerm

# Posterior probability from which on another effect counts as inseparable.
_MIN_INSEPARABLE_PROBABILITY = 0.05
# Gain of ln likelihood below which the prior would decide between hypotheses.
_MIN_CLEAR_GAIN = 40.0
# Factor by which the prior odds of an effect may be wrong; it matters where another effect fits as well or
# the gain is small.
_PRIOR_UNCERTAINTY = 3.0
# Upper limit of the confidence of an unnamed term, and of an effect at a plausible limit, if something fits
# better, or if an unnamed term on the same node has this many times its gain, whose residual can imitate it.
_MAX_DOUBTED_CONFIDENCE, _MIN_UNNAMED_GAIN_RATIO = 0.8, 1.0
# -ln probability, by the jackknife, below which the parts of a log do not agree on an effect.
_MIN_CONSISTENT_SURPRISE = 5.0
# Blocks of some four seconds that show the correlation of uneven noise; half a drive has 16. With fewer,
# an effect must gain this many sigma of the level of the noise.
_MIN_UNEVEN_BLOCKS, _MIN_LEVEL_SIGMAS = 12, 3.0

# Parameter that is the shape of a drift, and how many sigmas determine it.
_SHAPE_PARAMETER, _MIN_SHAPE_SIGMAS = "time_constant", 3.0


def build_finding(
    term: ModelTerm,
    result: SearchResult,
    rounds: RoundsByKey,
    residuals: Sequence[Mapping[str, Residual]],
    held_out_gaps: Sequence[float],
    given: Effect | None = None,
) -> Finding:
    """Build the finding of a term.

    residuals, held_out_gaps: before and after the effect was added
    given: the effect of the model file that the term refines
    """
    judged, name = rounds.get(term.key), term.effect.name
    hypotheses: Sequence[Hypothesis] = () if judged is None else judged.hypotheses
    own = None if judged is None else judged.find_hypothesis(term.key)
    probabilities = sum_by_name(hypotheses, own)
    gains = {
        hypothesis.term.effect.name: hypothesis.gain
        for hypothesis in reversed(hypotheses)
        if hypothesis.term.effect.name != name
    }
    gains_below = {other: own.gain - gain for other, gain in gains.items()} if own is not None else {}
    parameters = _list_parameters(term, result.final, own)
    is_doubted = (
        _is_contested(own, hypotheses)
        or _is_hardly_repeated(own, result.final)
        or _is_inconsistent(own, result)
        or _is_doubted(term, parameters, result, rounds)
    )
    confidence = _limit_confidence(probabilities.get(name, 0.0), own, gains_below, is_doubted)
    equal = _list_equal_scopes(hypotheses, own)
    if own is not None and equal:
        confidence *= own.probability / sum(one.probability for one in equal)
    others = sorted(
        ((probability, other) for other, probability in probabilities.items() if other != name), reverse=True
    )
    inseparable = tuple(
        other
        for probability, other in others
        if probability > _MIN_INSEPARABLE_PROBABILITY or gains_below.get(other, np.inf) < MAX_SIMILAR_GAIN
    )
    where = own.proposal.where if own is not None and own.proposal is not None else ""
    where = where or describe_where(*residuals)
    if len(equal) > 1:
        where += f"; which of {', '.join(one.term.scope for one in equal)} it is remains in doubt"
    if inseparable:
        where += "; " + describe_manoeuvre(name, inseparable)
    return Finding(
        name,
        term.scope,
        _add_given_values(parameters, given),
        BeforeAfter(compute_gap(residuals[0]), compute_gap(residuals[1])),
        BeforeAfter(held_out_gaps[0], held_out_gaps[1]),
        1.0 if own is None else own.p_value(result.rounds[-1].null_distribution),
        float(min(confidence, 1.0)),
        where,
        (others[0][1], float(others[0][0])) if others else None,
        inseparable,
        _list_alternatives(hypotheses, {**probabilities, name: float(min(confidence, 1.0))}, own),
    )


def _list_equal_scopes(hypotheses: Sequence[Hypothesis], own: Hypothesis | None) -> list[Hypothesis]:
    """Return the scopes that share the probability of the effect: the log does not distinguish them.

    They share it in proportion to the priors of their values, see `share_between_scopes`.
    """
    if own is None or own.probability <= 0.0:
        return []
    return [
        one
        for one in hypotheses
        if one.term.effect.name == own.term.effect.name
        and isclose(_likelihood_share(one), _likelihood_share(own), rel_tol=1e-6)
    ]


def _likelihood_share(one: Hypothesis) -> float:
    return one.probability * exp(one.term.effect.neg_log_prior())


def _list_alternatives(
    hypotheses: Sequence[Hypothesis], probabilities: Mapping[str, float], own: Hypothesis | None
) -> tuple[tuple[str, str, float, float], ...]:
    """Return effect, scope, gain and probability of each effect, the most probable first.

    probabilities: probability of each effect over all its scopes, as stated for the finding and its runner-up
    """
    best: dict[str, Hypothesis] = {} if own is None else {own.term.effect.name: own}
    for hypothesis in hypotheses:
        best.setdefault(hypothesis.term.effect.name, hypothesis)
    rows = [(name, one.term.scope, one.gain, probabilities.get(name, 0.0)) for name, one in best.items()]
    return tuple(sorted(rows, key=lambda row: -row[3]))


def _add_given_values(parameters: dict[str, Estimate], given: Effect | None) -> dict[str, Estimate]:
    if given is None:
        return parameters
    was = given.values()
    return {name: replace(estimate, model_value=was[name]) for name, estimate in parameters.items()}


def _limit_confidence(
    probability: float, own: Hypothesis | None, gains_below: Mapping[str, float], is_doubted: bool
) -> float:
    """Return the confidence, limited by alternatives.

    probability: probability of the effect in its round
    gains_below: its gain minus that of each other effect
    """
    # An effect that fits better may have lost by its prior alone.
    is_beaten = any(difference < -MAX_SIMILAR_GAIN for difference in gains_below.values())
    similar = [other for other, difference in gains_below.items() if difference < MAX_SIMILAR_GAIN]
    is_faint = own is not None and own.gain < _MIN_CLEAR_GAIN
    if is_beaten or is_doubted or (similar and is_faint):
        probability = min(probability, _MAX_DOUBTED_CONFIDENCE)
    if is_faint or any(not other.startswith(PREFIX) for other in similar):
        probability /= probability + _PRIOR_UNCERTAINTY * (1.0 - probability)
    return probability


def _is_hardly_repeated(own: Hypothesis | None, final: Refit) -> bool:
    """Return True if a short log of uneven noise shows an effect by less than its level leaves in doubt.

    Few stretches neither show how correlated the residuals are nor contain the same manoeuvre twice.
    """
    gain = None if own is None else own.held_out_gain
    is_short = final.min_tempering > 1.0 and len(final.block_scores) < _MIN_UNEVEN_BLOCKS
    return gain is not None and is_short and gain.total < _MIN_LEVEL_SIGMAS * gain.level_sigma


def _is_inconsistent(own: Hypothesis | None, result: SearchResult) -> bool:
    """Return True if the parts of a log with correlated residuals do not agree on an effect.

    A warm-up follows a random walk of the bias, but without any part of it, the others give another warm-up.
    """
    if own is None or own.held_out_gain is None:
        return False
    is_correlated = result.rounds[-1].tempering > MIN_CORRELATED_TEMPERING
    return is_correlated and own.surprise < _MIN_CONSISTENT_SURPRISE


def _is_doubted(
    term: ModelTerm, parameters: Mapping[str, Estimate], result: SearchResult, rounds: RoundsByKey
) -> bool:
    """Return True if another cause or formula would leave nearly the same residual."""
    if term.effect.name.startswith(PREFIX):
        # The structure is there, but a formula with the spin fits about as well as one with its square.
        return True
    if implausible_parameters(term.effect):
        # The fit wants more than is plausible.
        return True
    is_correlated = result.rounds[-1].tempering > MIN_CORRELATED_TEMPERING
    return _is_overshadowed(term, result, rounds) or (is_correlated and _is_shapeless(parameters))


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


def _is_shapeless(parameters: Mapping[str, Estimate]) -> bool:
    """Return True if the time constant of a drift is not determined.

    Any slow drift looks like one with a time constant as long as the log, a random walk of a gyro as well.
    """
    shape = parameters.get(_SHAPE_PARAMETER)
    return (
        len(parameters) > 1
        and shape is not None
        and shape.value < _MIN_SHAPE_SIGMAS * (shape.sigma or np.inf)
    )


def _gain_of(rounds: RoundsByKey, term: ModelTerm) -> float:
    judged = rounds.get(term.key)
    own = None if judged is None else judged.find_hypothesis(term.key)
    return 0.0 if own is None else own.gain


def _list_parameters(term: ModelTerm, final: Refit, own: Hypothesis | None) -> dict[str, Estimate]:
    """Return parameters with sigmas, from the scatter detector that proposed it or from the fit."""
    if term.is_refittable:
        return estimate_parameters(term, final)
    effect = term.effect
    sigmas = {} if own is None or own.proposal is None else own.proposal.sigmas
    return {
        name: Estimate(value, sigmas.get(name), effect.unit(name))
        for name, value in effect.values().items()
        if name in effect.fitted_parameters()
    }


def estimate_parameters(term: ModelTerm, fit: Refit) -> dict[str, Estimate]:
    """Return parameters of a fit with sigmas, propagated from its coordinates."""
    effect = term.effect
    values = {name: value for name, value in effect.values().items() if name in effect.fitted_parameters()}
    indices = fit.coordinate_slice(term)
    scales = effect.coordinate_scales()
    robust_covariance, plain_covariance = (
        fit.robust_covariance[indices, indices],
        fit.covariance[indices, indices],
    )
    covariance = (
        robust_covariance if np.trace(robust_covariance) > np.trace(plain_covariance) else plain_covariance
    ) * np.outer(scales, scales)
    jacobian = np.empty((len(values), len(scales)))
    for k, scale in enumerate(scales):
        above, below = effect.coordinates().copy(), effect.coordinates().copy()
        above[k] += 1e-4 * scale
        below[k] -= 1e-4 * scale
        values_above, values_below = (
            effect.with_coordinates(above).values(),
            effect.with_coordinates(below).values(),
        )
        jacobian[:, k] = [(values_above[name] - values_below[name]) / (2e-4 * scale) for name in values]
    frozen = np.flatnonzero(np.diag(plain_covariance) <= 0.0)
    if len(frozen) and len(frozen) < len(scales):
        # An unobservable coordinate may have its usual size, which would shift the observable ones.
        observed = np.setdiff1d(np.arange(len(scales)), frozen)
        gram = fit.gram[indices, indices]
        shift = (
            np.linalg.pinv(gram[np.ix_(observed, observed)], hermitian=True) @ gram[np.ix_(observed, frozen)]
        )
        covariance[np.ix_(observed, observed)] += (
            shift @ shift.T * np.outer(scales[observed], scales[observed])
        )
    sigmas = np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))
    # A pruned coordinate is assumed, not estimated. In effects that can be pruned, each coordinate is one
    # parameter.
    sigmas[list(term.frozen)] = 0.0
    return {
        name: Estimate(value, float(sigma) if sigma > 0.0 else None, effect.unit(name))
        for (name, value), sigma in zip(values.items(), sigmas, strict=True)
    }
