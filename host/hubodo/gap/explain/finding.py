"""A name that the search gave, told: its parameters with sigmas, how sure it is, what else it could be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.gap.explain.descriptions import describe_manoeuvre, describe_where
from hubodo.gap.explain.result import BeforeAfter, Estimate, Finding
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.posterior import MAX_SIMILAR_GAIN, sum_by_name
from hubodo.gap.judge.reconsider import RoundsByKey
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.residual import Residual, compute_gap
from hubodo.gap.refit.refit import Refit
from hubodo.gap.state.terms import ALL, ModelTerm

# A rival with more than this share of the probability cannot be told apart.
_MIN_INSEPARABLE_PROBABILITY = 0.05
# Where the whole gain of ln likelihood is this faint, the prior alone would decide between rivals.
_MIN_CLEAR_GAIN = 40.0
# What was thought of a name beforehand may be wrong by this factor: where another fits as well, or the gain
# is faint, names differ by that alone.
_PRIOR_UNCERTAINTY = 3.0
# Confidence is no more than this where something fits better, or where structure without a name is near that
# is larger by this factor: what the term of a library leaves of it could pass for an effect.
_MAX_DOUBTED_CONFIDENCE, _MIN_UNNAMED_GAIN_RATIO = 0.8, 1.0


def build_finding(
    term: ModelTerm,
    result: SearchResult,
    rounds: RoundsByKey,
    residuals: Sequence[Mapping[str, Residual]],
    held_out_gaps: Sequence[float],
) -> Finding:
    """What is said of a term. steps, outside: residuals and held-out gap before and after it was added."""
    made, name = rounds.get(term.key), term.effect.name
    rivals: Sequence[Hypothesis] = () if made is None else made.hypotheses
    own = None if made is None else made.find_hypothesis(term.key)
    shares = sum_by_name(rivals, own)
    gains = {it.term.effect.name: it.gain for it in reversed(rivals) if it.term.effect.name != name}
    behind = {other: own.gain - gain for other, gain in gains.items()} if own is not None else {}
    doubted = _is_overshadowed(term, result, rounds)
    confidence = _limit_confidence(shares.get(name, 0.0), own, behind, doubted)
    others = sorted(((share, other) for other, share in shares.items() if other != name), reverse=True)
    alike = tuple(
        other
        for share, other in others
        if share > _MIN_INSEPARABLE_PROBABILITY or behind.get(other, np.inf) < MAX_SIMILAR_GAIN
    )
    words = own.proposal.where if own is not None and own.proposal is not None else ""
    words = words or describe_where(*residuals)
    if alike:
        words += "; " + describe_manoeuvre(name, alike)
    return Finding(
        name,
        term.scope,
        _list_parameters(term, result.final, own),
        BeforeAfter(compute_gap(residuals[0]), compute_gap(residuals[1])),
        BeforeAfter(held_out_gaps[0], held_out_gaps[1]),
        1.0 if own is None else own.p_value(result.rounds[-1].null_distribution),
        float(min(confidence, 1.0)),
        words,
        (others[0][1], float(others[0][0])) if others else None,
        alike,
        tuple((it.term.effect.name, it.term.scope, it.gain, it.probability) for it in rivals),
    )


def _limit_confidence(
    probability: float, own: Hypothesis | None, gains_below: Mapping[str, float], is_overshadowed: bool
) -> float:
    """share: probability of the name in its round. behind: gain of each other name below its own."""
    # What fits better may only be thought less likely beforehand.
    better = any(by < -MAX_SIMILAR_GAIN for by in gains_below.values())
    near = [other for other, by in gains_below.items() if by < MAX_SIMILAR_GAIN]
    faint = own is not None and own.gain < _MIN_CLEAR_GAIN
    if better or is_overshadowed or (near and faint):
        probability = min(probability, _MAX_DOUBTED_CONFIDENCE)
    if faint or any(not other.startswith(PREFIX) for other in near):
        probability /= probability + _PRIOR_UNCERTAINTY * (1.0 - probability)
    return probability


def _is_overshadowed(term: ModelTerm, result: SearchResult, rounds: RoundsByKey) -> bool:
    """Whether structure without a name, on the same nodes, is larger than it."""
    terms = [other for other in result.final.state.terms if other.is_fitted]
    nodes = result.final.state.problem.nodes
    near = [term.scope, *(node.name for node in nodes if term.scope == ALL)]
    return any(
        other.effect.name.startswith(PREFIX)
        and other.scope in near
        and _gain_of(rounds, other) > _MIN_UNNAMED_GAIN_RATIO * _gain_of(rounds, term)
        for other in terms
    )


def _gain_of(rounds: RoundsByKey, term: ModelTerm) -> float:
    made = rounds.get(term.key)
    own = None if made is None else made.find_hypothesis(term.key)
    return 0.0 if own is None else own.gain


def _list_parameters(term: ModelTerm, final: Refit, own: Hypothesis | None) -> dict[str, Estimate]:
    """Values with sigmas: those of a look at scatter where one proposed it, else those of the fit."""
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
    """Values with sigmas of the fit, carried from its coordinates to the parameters."""
    effect = term.effect
    values = {name: value for name, value in effect.values().items() if name in effect.fitted_parameters()}
    place = fit.coordinate_slice(term)
    scales = effect.coordinate_scales()
    robust, plain = fit.robust_covariance[place, place], fit.covariance[place, place]
    whole = (robust if np.trace(robust) > np.trace(plain) else plain) * np.outer(scales, scales)
    jacobian = np.empty((len(values), len(scales)))
    for k, scale in enumerate(scales):
        further, back = effect.coordinates().copy(), effect.coordinates().copy()
        further[k] += 1e-4 * scale
        back[k] -= 1e-4 * scale
        ahead, behind = effect.with_coordinates(further).values(), effect.with_coordinates(back).values()
        jacobian[:, k] = [(ahead[name] - behind[name]) / (2e-4 * scale) for name in values]
    frozen = np.flatnonzero(np.diag(plain) <= 0.0)
    if len(frozen) and len(frozen) < len(scales):
        # What cannot be seen may still be there, as large as usual, and shifts what is seen.
        seen = np.setdiff1d(np.arange(len(scales)), frozen)
        gram = fit.gram[place, place]
        shift = np.linalg.pinv(gram[np.ix_(seen, seen)], hermitian=True) @ gram[np.ix_(seen, frozen)]
        whole[np.ix_(seen, seen)] += shift @ shift.T * np.outer(scales[seen], scales[seen])
    sigmas = np.sqrt(np.diag(jacobian @ whole @ jacobian.T))
    return {
        name: Estimate(value, float(sigma) if sigma > 0.0 else None, effect.unit(name))
        for (name, value), sigma in zip(values.items(), sigmas, strict=True)
    }
