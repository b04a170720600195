"""A name that the search gave, told: its parameters with sigmas, how sure it is, what else it could be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.posterior import NEAR, by_name
from hubodo.gap.judge.reconsider import Rounds
from hubodo.gap.judge.rival import Rival
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.residual import Residual, gap
from hubodo.gap.refit.refit import Refit
from hubodo.gap.state.terms import ALL, ModelTerm
from hubodo.gap.tell.result import BeforeAfter, Finding, Value
from hubodo.gap.tell.words import manoeuvre, where_words

# A rival with more than this share of the probability cannot be told apart.
_ALIKE = 0.05
# Where the whole gain of ln likelihood is this faint, the prior alone would decide between rivals.
_FAINT = 40.0
# What was thought of a name beforehand may be wrong by this factor: where another fits as well, or the gain
# is faint, names differ by that alone.
_PRIOR = 3.0
# Confidence is no more than this where something fits better, or where structure without a name is near that
# is larger by this factor: what the term of a library leaves of it could pass for an effect.
_DOUBTED, _SHADOW = 0.8, 1.0


def finding(
    term: ModelTerm,
    found: SearchResult,
    rounds: Rounds,
    steps: Sequence[Mapping[str, Residual]],
    outside: Sequence[float],
) -> Finding:
    """What is said of a term. steps, outside: residuals and held-out gap before and after it was added."""
    made, name = rounds.get(term.key), term.effect.name
    rivals: Sequence[Rival] = () if made is None else made.rivals
    own = None if made is None else made.rival(term.key)
    shares = by_name(rivals, own)
    gains = {it.term.effect.name: it.gain for it in reversed(rivals) if it.term.effect.name != name}
    behind = {other: own.gain - gain for other, gain in gains.items()} if own is not None else {}
    doubted = _in_shadow(term, found, rounds)
    confidence = _confidence(shares.get(name, 0.0), own, behind, doubted)
    others = sorted(((share, other) for other, share in shares.items() if other != name), reverse=True)
    alike = tuple(other for share, other in others if share > _ALIKE or behind.get(other, np.inf) < NEAR)
    words = own.proposal.where if own is not None and own.proposal is not None else ""
    words = words or where_words(*steps)
    if alike:
        words += "; " + manoeuvre(name, alike)
    return Finding(
        name,
        term.scope,
        _parameters(term, found.final, own),
        BeforeAfter(gap(steps[0]), gap(steps[1])),
        BeforeAfter(outside[0], outside[1]),
        1.0 if own is None else own.p_value(found.rounds[-1].null),
        float(min(confidence, 1.0)),
        words,
        (others[0][1], float(others[0][0])) if others else None,
        alike,
        tuple((it.term.effect.name, it.term.scope, it.gain, it.probability) for it in rivals),
    )


def _confidence(share: float, own: Rival | None, behind: Mapping[str, float], in_shadow: bool) -> float:
    """share: probability of the name in its round. behind: gain of each other name below its own."""
    # What fits better may only be thought less likely beforehand.
    better = any(by < -NEAR for by in behind.values())
    near = [other for other, by in behind.items() if by < NEAR]
    faint = own is not None and own.gain < _FAINT
    if better or in_shadow or (near and faint):
        share = min(share, _DOUBTED)
    if faint or any(not other.startswith(PREFIX) for other in near):
        share /= share + _PRIOR * (1.0 - share)
    return share


def _in_shadow(term: ModelTerm, found: SearchResult, rounds: Rounds) -> bool:
    """Whether structure without a name, on the same nodes, is larger than it."""
    terms = [other for other in found.final.state.terms if other.fitted]
    nodes = found.final.state.problem.nodes
    near = [term.scope, *(node.name for node in nodes if term.scope == ALL)]
    return any(
        other.effect.name.startswith(PREFIX)
        and other.scope in near
        and _gain_of(rounds, other) > _SHADOW * _gain_of(rounds, term)
        for other in terms
    )


def _gain_of(rounds: Rounds, term: ModelTerm) -> float:
    made = rounds.get(term.key)
    own = None if made is None else made.rival(term.key)
    return 0.0 if own is None else own.gain


def _parameters(term: ModelTerm, final: Refit, own: Rival | None) -> dict[str, Value]:
    """Values with sigmas: those of a look at scatter where one proposed it, else those of the fit."""
    if term.moves:
        return fitted_values(term, final)
    effect = term.effect
    sigmas = {} if own is None or own.proposal is None else own.proposal.sigmas
    return {
        name: Value(value, sigmas.get(name), effect.unit(name))
        for name, value in effect.values().items()
        if name in effect.fitted_parameters()
    }


def fitted_values(term: ModelTerm, final: Refit) -> dict[str, Value]:
    """Values with sigmas of the fit, carried from its coordinates to the parameters."""
    effect = term.effect
    values = {name: value for name, value in effect.values().items() if name in effect.fitted_parameters()}
    place = final.place(term)
    scales = effect.coordinate_scales()
    robust, plain = final.robust[place, place], final.covariance[place, place]
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
        gram = final.gram[place, place]
        shift = np.linalg.pinv(gram[np.ix_(seen, seen)], hermitian=True) @ gram[np.ix_(seen, frozen)]
        whole[np.ix_(seen, seen)] += shift @ shift.T * np.outer(scales[seen], scales[seen])
    sigmas = np.sqrt(np.diag(jacobian @ whole @ jacobian.T))
    return {
        name: Value(value, float(sigma) if sigma > 0.0 else None, effect.unit(name))
        for (name, value), sigma in zip(values.items(), sigmas, strict=True)
    }
