"""Candidates for a change between two logs, judged by the gain of separate values over a common one.

An effect that the model lacks in both logs, with the same value, is no change. Where residuals are
correlated, a change has to gain on folds of time to which it was not fitted.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.plausibility import implausible_parameters
from hubodo.gap.change.joint import (
    FROZEN_VARIANCE,
    EffectKey,
    Indices,
    JointFit,
    JointGrams,
    join_logs,
    linearise_log,
)
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.refit.cross_validation import HeldOutGain, compute_held_out_gain
from hubodo.gap.refit.linear_fit import Refit, linearise_fit
from hubodo.gap.refit.prior import coordinate_slice
from hubodo.gap.refit.refit import continue_fit
from hubodo.gap.screen.candidates import Candidate
from hubodo.gap.screen.evidence import compute_log_evidence
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ALL, ModelTerm, list_scopes

# Candidates that are fitted fully in each round.
_MAX_REFITTED_CHANGES = 5
# Iterations of a fit of one log.
_MAX_CANDIDATE_ITERATIONS = 4
# Held-out gain that a change needs where residuals are correlated: in sigma, as a share of the gain, and in
# sigma of noise whose level differs. One pair of drives of an unchanged car reached 0.13 of the last.
_MIN_CHANGE_HELD_OUT_Z, _MIN_CHANGE_HELD_OUT_SHARE, _MIN_CHANGE_LEVEL_SIGMAS = 5.0, 0.3, 0.2
# Change in usual sizes, and in sigma from the scatter of blocks, up to which a property of the vehicle
# differs between drives anyway, where residuals are correlated.
_MIN_CHANGE_SCALES, _MIN_CHANGE_SIGMA, _CORRELATED_TEMPERING = 0.15, 5.0, 2.0


@dataclass(frozen=True)
class LogPair:
    """Two logs under one model, of which some terms have a value for each log.

    fits: fits of the separate terms before and after, everything else fixed
    separate: keys of terms with a value for each log
    """

    fits: tuple[Refit, Refit]
    separate: frozenset[EffectKey]
    tempering: float

    @property
    def evaluations(self) -> tuple[Evaluation, Evaluation]:
        return self.fits[0].evaluation, self.fits[1].evaluation

    @cached_property
    def joint(self) -> JointGrams:
        """Return both logs linearised along every candidate and all terms."""
        logs = [linearise_log(free_all_terms(one), with_candidates=True) for one in self.evaluations]
        return join_logs(logs[0], logs[1], self.separate, self.tempering)


def free_all_terms(evaluation: Evaluation) -> Evaluation:
    """Return the evaluation with all terms free."""
    terms = [_set_fitted(term, is_fitted=True) for term in evaluation.state.terms]
    return evaluation.with_state(evaluation.state.with_terms(terms))


def _set_fitted(term: ModelTerm, is_fitted: bool) -> ModelTerm:
    """Return the term as fitted or fixed: an effect that differs between the logs is no nuisance."""
    return _freeze_implausible(replace(term, is_fitted=is_fitted, repeatability=0.0))


def _freeze_implausible(term: ModelTerm) -> ModelTerm:
    """Return the term with parameters at their plausible limit frozen: no step may exceed the limit."""
    names, effect = term.effect.fitted_parameters(), term.effect
    if len(names) != len(effect.coordinates()):
        return term
    at_limit = {names.index(name) for name in implausible_parameters(effect)}
    return replace(term, frozen=tuple(sorted({*term.frozen, *at_limit})))


def fit_separate(
    evaluations: Sequence[Evaluation], separate: Collection[EffectKey], tempering: float, rounds: int
) -> LogPair:
    """Fit the separate terms of each log; all other terms are fixed."""
    fits = [_fit_log(one, separate, rounds) for one in evaluations]
    return LogPair((fits[0], fits[1]), frozenset(separate), tempering)


def _fit_log(evaluation: Evaluation, separate: Collection[EffectKey], rounds: int) -> Refit:
    state = evaluation.state
    terms = [_set_fitted(term, term.key in separate) for term in state.terms]
    return continue_fit(linearise_fit(evaluation.with_state(state.with_terms(terms))), rounds).without_cache()


@dataclass(frozen=True)
class ChangeCandidate:
    """A candidate for a change.

    hypothesis: gain of separate values over a common value, and posterior
    pair: both logs with separate values of the candidate
    """

    hypothesis: Hypothesis
    pair: LogPair

    @property
    def key(self) -> EffectKey:
        return self.hypothesis.key


def add_term(state: State, term: ModelTerm) -> State:
    """Return a state with one more term, which replaces those of other scopes.

    A term of one node replaces one of all nodes, of which each other node receives a copy.
    """
    name, scope = term.key
    scopes = list_scopes(type(term.effect), state.problem.nodes)
    present = {other.scope for other in state.terms if other.effect.name == name}
    copies, dropped = list[ModelTerm](), {scope}
    if scope == ALL:
        dropped |= set(scopes)
    elif ALL in present:
        shared = next(other for other in state.terms if other.key == (name, ALL))
        copies = [replace(shared, scope=one) for one in scopes if one not in (ALL, scope, *present)]
        dropped |= {ALL}
    terms = [other for other in state.terms if other.effect.name != name or other.scope not in dropped]
    return state.with_terms([*terms, *copies, term])


def separate_keys(separate: Collection[EffectKey], state: State, key: EffectKey) -> frozenset[EffectKey]:
    """Return the keys of the terms of a state that have a value for each log.

    separate: such keys so far, without `key`
    """
    was_shared = (key[0], ALL) in separate
    return frozenset(
        term.key
        for term in state.terms
        if term.key in separate or term.key == key or (was_shared and term.effect.name == key[0])
    )


def list_differences(pair: LogPair) -> list[ChangeCandidate]:
    """Return the most promising candidates visible in the mean, fitted in both logs."""
    joint = pair.joint
    known = {term.key for term in joint.logs[0].terms}
    screened = []
    for candidate in joint.logs[0].candidates:
        if candidate.term.key not in pair.separate:
            evidence = _screen(joint, candidate, candidate.term.key in known, pair.tempering)
            screened.append((evidence, candidate))
    screened.sort(key=lambda item: -item[0])
    selected: dict[EffectKey, Candidate] = {}
    for evidence, candidate in screened:
        if evidence < 0.0 or len(selected) == _MAX_REFITTED_CHANGES:
            break
        selected.setdefault(candidate.term.key, candidate)
    fitted = [_fit_candidate(pair, candidate, key in known) for key, candidate in selected.items()]
    # The block scores of the best fit show by how much correlation inflates the gains.
    tempering = min(fitted, key=lambda one: one.best.deviance).tempering if fitted else 1.0
    return [_judge(one, tempering) for one in fitted]


def _screen(joint: JointGrams, candidate: Candidate, is_known: bool, tempering: float) -> float:
    """Return ln of the Bayes factor of separate values, to first order."""
    common, separate = joint.fit_candidate(candidate, is_known)
    k = candidate.basis.shape[1]
    gain = 0.5 * (common.objective - separate.objective)
    return _evidence(gain, separate.step[-k:], separate.covariance[-k:, -k:], tempering)


def _evidence(gain: float, change: Array, covariance: Array, tempering: float) -> float:
    """Return ln of the Bayes factor of a change; change: (k,) in scales."""
    information = np.zeros_like(covariance)
    observed = np.flatnonzero(np.diag(covariance) > 0.0)
    information[np.ix_(observed, observed)] = np.linalg.pinv(
        covariance[np.ix_(observed, observed)], hermitian=True
    )
    return compute_log_evidence(gain / tempering, change, information / tempering)


@dataclass(frozen=True)
class _FittedCandidate:
    """A candidate with a value for each log.

    common: fit with a value common to both logs
    best: fit with a value for each
    terms: before and after
    indices: indices of its coordinates in `best`, before and after
    """

    pair: LogPair
    common: JointFit
    best: JointFit
    terms: tuple[ModelTerm, ModelTerm]
    indices: tuple[Indices, Indices]

    @property
    def tempering(self) -> float:
        """Return the factor by which correlated residuals inflate gains."""
        return max(self.pair.tempering, *(fit.tempering for fit in self.pair.fits))

    @property
    def change(self) -> Array:
        """Return the change of the coordinates, (k,) in scales."""
        before, after = (
            term.effect.coordinates() / term.effect.coordinate_scales() + self.best.step[place]
            for term, place in zip(self.terms, self.indices, strict=True)
        )
        return np.asarray(after - before)


def _fit_candidate(pair: LogPair, candidate: Candidate, is_known: bool) -> _FittedCandidate:
    """Fit a candidate in each log, and with a value common to both."""
    term = candidate.term
    evaluations = [
        one.with_state(one.state if is_known else add_term(one.state, term)) for one in pair.evaluations
    ]
    separate = separate_keys(pair.separate, evaluations[0].state, term.key)
    fitted = fit_separate(evaluations, separate, pair.tempering, _MAX_CANDIDATE_ITERATIONS)
    logs = [linearise_log(free_all_terms(one), with_candidates=False) for one in fitted.evaluations]
    joint = join_logs(logs[0], logs[1], separate, pair.tempering)
    indices = [
        place[coordinate_slice(log.terms, term)] for place, log in zip(joint.indices, logs, strict=True)
    ]
    terms = [next(one for one in log.terms if one.key == term.key) for log in logs]
    common, _ = pair.joint.fit_candidate(candidate, is_known)
    return _FittedCandidate(fitted, common, joint.fit(), (terms[0], terms[1]), (indices[0], indices[1]))


def _judge(one: _FittedCandidate, tempering: float) -> ChangeCandidate:
    """Judge a candidate by its gain over a value common to both logs."""
    gain = 0.5 * (one.common.objective - one.best.objective)
    hypothesis = _judge_change(one.terms, one.change, one.indices, gain, (one.common, one.best), tempering)
    return ChangeCandidate(hypothesis, one.pair)


def _judge_change(
    terms: Sequence[ModelTerm],
    change: Array,
    indices: Sequence[Indices],
    gain: float,
    fits: tuple[JointFit, JointFit],
    tempering: float,
) -> Hypothesis:
    """Judge a change of a term.

    terms, indices: before and after
    change: (k,) in scales
    fits: with a common value, and with a value for each log
    """
    effect = terms[1].effect
    covariance = _difference_covariance(fits[1].covariance, *indices)
    evidence = _evidence(gain, change, covariance, tempering) - effect.neg_log_prior()
    held_out_gain = compute_held_out_gain(fits[0].fold_deviances, fits[1].fold_deviances)
    objection = ""
    if _newly_implausible(terms):
        objection = "fits only beyond its plausible limit"
    elif not _helps_held_out(gain, held_out_gain, tempering):
        objection = "does not help on samples to which it was not fitted"
    elif (
        not effect.varies_between_drives
        and tempering > _CORRELATED_TEMPERING
        and _is_minor(change, _change_sigma(fits[1], indices))
    ):
        objection = "differs by no more than drives differ"
    hypothesis = Hypothesis(terms[1], gain, evidence, 0.0, None, None, held_out_gain)
    return hypothesis.with_objection(objection) if objection else hypothesis


def _helps_held_out(gain: float, held_out_gain: HeldOutGain, tempering: float) -> bool:
    """Return True if a change gains more on held-out folds than correlated residuals do by chance."""
    correlated_share = 1.0 - 1.0 / tempering
    minimum = max(_MIN_CHANGE_HELD_OUT_SHARE * gain, _MIN_CHANGE_LEVEL_SIGMAS * held_out_gain.level_sigma)
    return (
        held_out_gain.z >= _MIN_CHANGE_HELD_OUT_Z * correlated_share
        and held_out_gain.total >= minimum * correlated_share
    )


def rejudge_change(pair: LogPair, key: EffectKey, tempering: float) -> Hypothesis:
    """Judge a change again, with all other changes in the model."""
    logs = [linearise_log(free_all_terms(one), with_candidates=False) for one in pair.evaluations]
    joint = join_logs(logs[0], logs[1], pair.separate, pair.tempering)
    terms = [next(one for one in log.terms if one.key == key) for log in logs]
    indices = [
        place[coordinate_slice(log.terms, terms[0])] for place, log in zip(joint.indices, logs, strict=True)
    ]
    scales = terms[0].effect.coordinate_scales()
    difference = (terms[1].effect.coordinates() - terms[0].effect.coordinates()) / scales
    best = joint.fit()
    common = joint.fit_equal(indices[0], indices[1], difference)
    change = difference + best.step[indices[1]] - best.step[indices[0]]
    gain = 0.5 * (common.objective - best.objective)
    return _judge_change(terms, change, indices, gain, (common, best), tempering)


def _difference_covariance(covariance: Array, before: Indices, after: Indices) -> Array:
    """Return the covariance of a change, (k, k); zero for coordinates that a log does not determine."""
    total = covariance[np.ix_(before, before)] + covariance[np.ix_(after, after)]
    cross = covariance[np.ix_(before, after)]
    variance = np.minimum(np.diag(covariance)[before], np.diag(covariance)[after])
    is_observed = variance > FROZEN_VARIANCE
    return np.asarray((total - cross - cross.T) * np.outer(is_observed, is_observed))


def _change_sigma(fit: JointFit, indices: Sequence[Indices]) -> Array:
    """Return 1 sigma of each coordinate of a change, (k,), as reported; zero for unobservable ones."""
    variances = [
        np.max([np.diag(one)[place] for one in (fit.covariance, fit.robust_covariance)], axis=0)
        for place in indices
    ]
    is_observed = np.min([np.diag(fit.covariance)[place] for place in indices], axis=0) > FROZEN_VARIANCE
    return np.asarray(np.sqrt(variances[0] + variances[1]) * is_observed)


def _newly_implausible(terms: Sequence[ModelTerm]) -> bool:
    """Return True if a parameter is at its plausible limit in the second log only."""
    before, after = (set(implausible_parameters(term.effect)) for term in terms)
    return bool(after - before)


def _is_minor(change: Array, sigma: Array) -> bool:
    """Return True if no coordinate changes by more than drives of one vehicle differ."""
    is_large = (np.abs(change) > _MIN_CHANGE_SCALES) & (np.abs(change) > _MIN_CHANGE_SIGMA * sigma)
    return not bool(np.any(is_large & (sigma > 0.0)))
