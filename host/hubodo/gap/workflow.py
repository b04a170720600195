"""The workflow: search, reconsider each name beside its rivals, measure what shrank on data not fitted."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.gap.held_out import Split, split
from hubodo.gap.problem import Problem, build
from hubodo.gap.reconsider import beyond_chance, reconsider
from hubodo.gap.refit import Refit, refit
from hubodo.gap.remaining import remaining
from hubodo.gap.result import GapResult, Named, Shrink, Value, Verdict, by_channel
from hubodo.gap.round import Rival, Round
from hubodo.gap.search import Found, Say, initial_state, search
from hubodo.gap.size import Trace, floor, gap, traces
from hubodo.gap.state import State
from hubodo.gap.terms import ALL, VEHICLE, Term
from hubodo.gap.wander import Weights
from hubodo.gap.words import manoeuvre, where_words
from hubodo.model.model_file import Model, Scoped
from hubodo.recording import Recording

# A rival with more than this share of the probability cannot be told apart.
_ALIKE = 0.05
# Nor one that fits as well but for so much of ln likelihood, whatever was thought of it beforehand; where the
# whole gain is this faint, the prior alone would decide between them.
_NEAR, _FAINT = 3.0, 40.0
# What was thought of a name beforehand may be wrong by this factor; a faint gain has to do without it.
_PRIOR = 3.0
# Confidence is no more than this where something fits better, or where structure without a name is near that
# is larger by this factor: what the term of a library leaves of it could pass for an effect.
_DOUBTED, _SHADOW = 0.8, 1.0
# A gap so much larger than that of noise alone is not explained, whatever was found.
_NOISE_ALONE = 1.5


def find_gap(
    recording: Recording,
    model: Model,
    *,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    where: str = "log",
    say: Say = lambda words, share: None,
) -> GapResult:
    """Where a log and a model disagree, what is missing, and the model with it.

    accept: names of effects that are added before anything is searched. reject: names not considered.
    Raises InputError when the log has not what the model needs.
    """
    problem = build(recording, model, where)
    say("following the wheels", 0.02)
    begin = initial_state(problem)
    found = search(problem, begin, accept, reject, say)
    say("reconsidering each name", 0.8)
    found, rounds = reconsider(problem, found, accept, reject)
    found, rounds = beyond_chance(problem, found, rounds, accept)
    say("measuring on what was not fitted", 0.9)
    there = {term.effect.name for term in found.final.state.terms}
    unseen = [f"{name}: accepted, but nothing in this log shows it" for name in accept if name not in there]
    return _result(replace(problem, warnings=(*problem.warnings, *unseen)), begin, found, rounds)


def _result(
    problem: Problem, begin: State, found: Found, rounds: Mapping[tuple[str, str], Round]
) -> GapResult:
    held = split(problem)
    final_weights = found.weights
    terms = [term for term in found.final.state.terms if term.fitted]
    given = [term for term in found.final.state.terms if not term.fitted]
    states = [_stage(problem, begin, terms[:k], final_weights) for k in range(len(terms))] + [found.final]
    steps = [traces(problem, one.state, final_weights) for one in states]
    outside = [_trained(problem, one, final_weights, held) for one in states]
    named = []
    for k, term in enumerate(terms):
        near = [term.scope, *(node.name for node in problem.nodes if term.scope == ALL)]
        shadow = any(
            other.effect.name.startswith(PREFIX)
            and other.scope in near
            and _gain_of(rounds, other) > _SHADOW * _gain_of(rounds, term)
            for other in terms
        )
        judged = rounds.get(term.key)
        one = _named(problem, term, found, judged, steps[k : k + 2], outside[k : k + 2], shadow)
        named += by_channel(one) if one.effect.startswith(PREFIX) else [one]
    lowest = floor(steps[-1], final_weights)
    whole = Shrink(gap(steps[0]), gap(steps[-1]), lowest)
    left, unexplained = remaining(problem, found.final, final_weights, steps[-1])
    unexplained |= whole.after > _NOISE_ALONE * lowest
    verdict: Verdict
    if named:
        verdict = "partly_explained" if unexplained else "explained"
    else:
        verdict = "unexplained" if unexplained else "no_gap"
    return GapResult(
        verdict,
        whole,
        Shrink(outside[0], outside[-1]),
        held.kind,
        tuple(named),
        tuple(left),
        problem.warnings,
        _with(problem.model, [*given, *terms]),
        found,
        tuple(steps),
    )


def _stage(problem: Problem, begin: State, terms: Sequence[Term], weighed: Weights) -> Refit:
    """The model as it was with only the first effects found, fitted anew."""
    keys = {term.key for term in terms}
    kept = [term for term in begin.terms if term.key not in keys]
    return refit(problem, begin.with_terms([*kept, *terms]), weighed, rounds=2)


def _trained(problem: Problem, one: Refit, weighed: Weights, held: Split) -> float:
    """The gap on what was held out, with the terms fitted to the rest."""
    trained = refit(problem, one.state, held.without(weighed), rounds=2)
    return gap(traces(problem, trained.state, weighed), held.inside)


def _named(
    problem: Problem,
    term: Term,
    found: Found,
    made: Round | None,
    steps: Sequence[Mapping[str, Trace]],
    outside: Sequence[float],
    in_shadow: bool,
) -> Named:
    by_name: dict[str, float] = {}
    rivals: Sequence[Rival] = () if made is None else made.rivals
    for rival in rivals:
        by_name[rival.term.effect.name] = by_name.get(rival.term.effect.name, 0.0) + rival.probability
    name = term.effect.name
    own = None if made is None else made.rival(term.key)
    gains = {it.term.effect.name: it.gain for it in reversed(rivals) if it.term.effect.name != name}
    behind = {other: own.gain - gain for other, gain in gains.items()} if own is not None else {}
    near = {other for other, by in behind.items() if by < _NEAR}
    confidence = by_name.get(name, 0.0)
    # What fits better may only be thought less likely beforehand.
    better = any(by < -_NEAR for by in behind.values())
    if better or in_shadow or (near and own is not None and own.gain < _FAINT):
        confidence = min(confidence, _DOUBTED)
    if own is not None and own.gain < _FAINT:
        confidence /= confidence + _PRIOR * (1.0 - confidence)
    others = sorted(((share, other) for other, share in by_name.items() if other != name), reverse=True)
    alike = tuple(other for share, other in others if share > _ALIKE or other in near)
    words = own.proposal.where if own is not None and own.proposal is not None else ""
    words = words or where_words(problem, *steps)
    if alike:
        words += "; " + manoeuvre(name, alike)
    return Named(
        name,
        term.scope,
        _parameters(term, found.final, own),
        Shrink(gap(steps[0]), gap(steps[1])),
        Shrink(outside[0], outside[1]),
        1.0 if own is None else own.p_value(found.rounds[-1].chance),
        float(min(confidence, 1.0)),
        words,
        (others[0][1], float(others[0][0])) if others else None,
        alike,
        tuple((it.term.effect.name, it.term.scope, it.gain, it.probability) for it in rivals),
        term,
    )


def _gain_of(rounds: Mapping[tuple[str, str], Round], term: Term) -> float:
    made = rounds.get(term.key)
    own = None if made is None else made.rival(term.key)
    return 0.0 if own is None else own.gain


def _parameters(term: Term, final: Refit, own: Rival | None) -> dict[str, Value]:
    """Values with sigmas: those of the fit, carried from its coordinates to the parameters."""
    effect = term.effect
    values = {name: value for name, value in effect.values().items() if name in effect.fitted()}
    if own is not None and own.proposal is not None:
        return {
            name: Value(value, own.proposal.sigmas.get(name), effect.unit(name))
            for name, value in values.items()
        }
    place = final.place(term)
    scales = effect.coordinate_scales()
    robust, plain = final.robust[place, place], final.covariance[place, place]
    whole = (robust if np.trace(robust) > np.trace(plain) else plain) * np.outer(scales, scales)
    jacobian = np.empty((len(values), len(scales)))
    for k, scale in enumerate(scales):
        further, back = effect.coordinates().copy(), effect.coordinates().copy()
        further[k] += 1e-4 * scale
        back[k] -= 1e-4 * scale
        ahead, behind = effect.at(further).values(), effect.at(back).values()
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


def _with(model: Model, terms: Sequence[Term]) -> Model:
    scoped = [Scoped(term.effect, None if term.scope in (ALL, VEHICLE) else term.scope) for term in terms]
    return replace(model, effects=()).with_effects(*scoped)
