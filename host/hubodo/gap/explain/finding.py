"""Findings: an added effect with parameters, sigmas, confidence and alternatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import exp, isclose

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.effects.empirical import PREFIX
from hubodo.gap.explain.descriptions import describe_manoeuvre, describe_where
from hubodo.gap.explain.doubt import is_doubted, widen_sigmas_by_doubtful_effects
from hubodo.gap.explain.result import BeforeAfter, Estimate, Finding
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.posterior import MAX_SIMILAR_GAIN, sum_by_name
from hubodo.gap.judge.round import RoundsByKey
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.residual import Residual, compute_gap
from hubodo.gap.refit.jackknife import compute_jackknife_covariance
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.state.terms import ModelTerm

# Posterior probability from which on another effect counts as inseparable.
_MIN_INSEPARABLE_PROBABILITY = 0.05
# Gain of ln likelihood below which the prior would decide between hypotheses.
_MIN_CLEAR_GAIN = 40.0
# Factor by which the prior odds of an effect may be wrong; it matters where another effect fits as well or
# the gain is small.
_PRIOR_UNCERTAINTY = 3.0
# Upper limit of the confidence if something fits better, or if a finding is in doubt.
_MAX_DOUBTED_CONFIDENCE = 0.8


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
    parameters = _list_parameters(term, result, own)
    doubted = is_doubted(term, own, hypotheses, parameters, result, rounds)
    confidence = _limit_confidence(probabilities.get(name, 0.0), own, gains_below, doubted)
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


def _list_parameters(term: ModelTerm, result: SearchResult, own: Hypothesis | None) -> dict[str, Estimate]:
    """Return parameters with sigmas, from the scatter detector that proposed it or from the fit."""
    if term.is_refittable:
        return widen_sigmas_by_doubtful_effects(
            term, estimate_parameters(term, result.final), result.rounds[-1].hypotheses
        )
    effect = term.effect
    sigmas = {} if own is None or own.proposal is None else own.proposal.sigmas
    return {
        name: Estimate(value, sigmas.get(name), effect.unit(name))
        for name, value in effect.values().items()
        if name in effect.fitted_parameters()
    }


def _join_covariances(candidates: Sequence[Array]) -> Array:
    """Return the covariance, (k, k), with the largest trace, with the largest variance of each coordinate."""
    largest = max(candidates, key=lambda one: float(np.trace(one)))
    variance = np.diag(largest)
    ratio = np.max([np.diag(one) for one in candidates], axis=0) / np.where(variance > 0.0, variance, 1.0)
    return largest * np.sqrt(np.outer(ratio, ratio))


def estimate_parameters(term: ModelTerm, fit: Refit) -> dict[str, Estimate]:
    """Return parameters of a fit with sigmas, propagated from its coordinates."""
    effect = term.effect
    values = {name: value for name, value in effect.values().items() if name in effect.fitted_parameters()}
    indices = fit.coordinate_slice(term)
    scales = effect.coordinate_scales()
    plain_covariance = fit.covariance[indices, indices]
    candidates = [plain_covariance, fit.robust_covariance[indices, indices]]
    if fit.groups is not None:
        places = np.arange(indices.start, indices.stop, dtype=np.intp)
        candidates.append(compute_jackknife_covariance(fit.groups, fit.prior, places))
    covariance = _join_covariances(candidates) * np.outer(scales, scales)
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
