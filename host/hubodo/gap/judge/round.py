"""One round of the search: screen all candidates, refit the best, judge them together."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.hypothesis import (
    DOUBTFUL_LEVEL,
    MIN_CORRELATED_TEMPERING,
    Baseline,
    Hypothesis,
    judge_effect,
    judge_proposal,
    judge_unnamed_term,
)
from hubodo.gap.judge.posterior import compute_posterior
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.process_noise.weights import Weights, declared_wheel_walk
from hubodo.gap.refit.refit import (
    Refit,
    compute_added_gain,
    compute_gain,
    continue_fit,
    fit_tracked,
    linearise_fit,
    refit,
)
from hubodo.gap.scatter import SCATTER_DETECTORS, Proposal
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.screen.screening import ScreenedCandidate, screen_candidates
from hubodo.gap.screen.unnamed_terms import UnnamedTerm, find_unnamed_terms
from hubodo.gap.state.terms import ALL

# Name for `--reject` that excludes all unnamed terms.
EMPIRICAL = "empirical"
# Settings of the search; chosen, and judged together by `make gap-matrix`.
# Posterior probability that anything is missing, from which on an effect is added.
MIN_ADD_PROBABILITY = 0.99
# Candidates to refit, the first of them of different effects; the duration of a round is proportional to it.
_MAX_REFITS, _MIN_REFITTED_EFFECTS = 6, 4
# Half of the best gain, in deviance per tempering, from which on candidates with less are abandoned.
_HOPELESS_DEVIANCE = 100.0
# Ratio of a wheel's walk to the declared one, from which on its angle counts as lost; additional candidates
# to refit in that case.
_LOST_WHEEL_RATIO, _MAX_STRICT_REFITS = 3.0, 3
# Unnamed terms to refit; share of the best gain, and evidence as ln Bayes factor, that each has to reach.
_MAX_UNNAMED_REFITS, _MIN_UNNAMED_SHARE, _MIN_UNNAMED_EVIDENCE = 2, 0.25, 3.0
# Ratio of the gain of an unnamed term to that of the best listed effect, below which it is that effect: in
# independent and in correlated residuals.
_MIN_UNNAMED_ADVANTAGE = (1.2, 2.0)
# Gain in ln likelihood, tempered, that a hypothesis has to have for each of its coordinates, where residuals
# are so correlated.
_COORDINATE_PENALTY = 10.0
# ln prior odds of an effect in one node over the same value in all.
_COINCIDENCE_NATS = math.log(2.0)
# ln Bayes factor for independent samples, from which on an effect is added provisionally.
_PROVISIONAL_EVIDENCE = 20.0
# Fractions of a round's progress after screening, refits, and comparison under common weights.
_PROGRESS_SCREENED, _PROGRESS_FITTED, _PROGRESS_COMPARED = 0.15, 0.6, 0.9

ReportProgress = Callable[[str, float], None]
"""Callback with the current activity, in words, and the completed share of the whole."""


@dataclass(frozen=True)
class Round:
    """A judged round.

    evaluation: at the start of the round
    hypotheses: the most probable first; only the first keeps its tracked wheels, from which the search may
        continue
    null_probability: posterior that nothing is missing
    screened: every candidate as screened, the best first
    null_distribution: null distribution of the largest gain
    tempering: factor by which gains were divided to account for correlated residuals
    """

    evaluation: Evaluation
    hypotheses: tuple[Hypothesis, ...]
    null_probability: float
    screened: tuple[ScreenedCandidate, ...]
    null_distribution: NullDistribution
    tempering: float = 1.0

    @property
    def best(self) -> Hypothesis | None:
        """Return the hypothesis to add; None if nothing missing is too probable."""
        return (
            self.hypotheses[0]
            if self.hypotheses and self.null_probability < 1.0 - MIN_ADD_PROBABILITY
            else None
        )

    @property
    def provisional(self) -> Hypothesis | None:
        """Return the hypothesis to add provisionally, or None.

        If several effects are missing, residuals stay correlated whichever is fitted, and tempering hides
        every gain. Returned is the hypothesis that would be added if the residuals were white.
        """
        if self.best is not None or not self.hypotheses:
            return None
        first = self.hypotheses[0]
        untempered_evidence = first.evidence + first.gain * (1.0 - 1.0 / self.tempering)
        is_named = not first.term.effect.name.startswith(PREFIX)
        return (
            first
            if is_named and first.evidence > 0.0 and untempered_evidence > _PROVISIONAL_EVIDENCE
            else None
        )

    def find_hypothesis(self, key: tuple[str, str]) -> Hypothesis | None:
        """Return the hypothesis of this effect and scope, or None."""
        return next((hypothesis for hypothesis in self.hypotheses if hypothesis.key == key), None)


def judge_round(
    evaluation: Evaluation,
    reject: Collection[str] = (),
    always_refit: Collection[tuple[str, str]] = (),
    report_progress: ReportProgress = lambda words, share: None,
) -> Round:
    """Judge one round from an evaluation.

    reject: effects not considered; `empirical` for all unnamed terms
    always_refit: effects and scopes refitted regardless of the screening
    report_progress: callback with activity and completed share of the round
    """
    report_progress("every effect in every scope", 0.0)
    before = refit(evaluation.without_cache(), rounds=1)
    strictly_screened = _screen_strictly(before, reject)
    screening = screen_candidates(before.evaluation, before.nuisance_information)
    screened = [item for item in screening.candidates if item.candidate.name not in reject]
    selected = _select_for_refit(screened, always_refit, strictly_screened)
    states = [before.state.with_term(item.candidate.term) for item in selected]
    evaluations = [before.evaluation.with_state(state) for state in states]
    # All hypotheses leave the same given effects free as the fit before, to which they are compared.
    initial_fits = [linearise_fit(one, screening.linearisation, before) for one in evaluations]
    null = screening.null_distribution
    del screening  # its matrices are large and no longer needed
    refits: list[Refit] = []
    for k, (item, initial_fit) in enumerate(zip(selected, initial_fits, strict=True)):
        report_progress(
            item.candidate.term.label,
            _PROGRESS_SCREENED + (_PROGRESS_FITTED - _PROGRESS_SCREENED) * k / len(selected),
        )
        refits.append(continue_fit(initial_fit, max_deviance=_max_deviance(before, refits)).without_cache())
    report_progress("comparing the best", _PROGRESS_FITTED)
    if refits:
        before, refits = _refit_with_common_weights(before, refits)
    report_progress("scatter, steps, limits, unnamed terms", _PROGRESS_COMPARED)
    proposals, walk_refits = _detect_scatter(before, reject)
    best_gain = max([compute_gain(before, item) for item in [*refits, *walk_refits.values()]], default=0.0)
    unnamed = [] if EMPIRICAL in reject else _select_unnamed_terms(before, best_gain)
    unnamed_refits = [_refit_with(before, item, rounds=1) for item in unnamed]
    all_refits = [*refits, *walk_refits.values(), *unnamed_refits]
    # The block scores of the best fit show by how much correlation inflates the gains.
    tempering = min(all_refits, key=lambda item: item.deviance).tempering if all_refits else 1.0
    baseline = Baseline(before, compute_added_gain(before), tempering)
    hypotheses = [judge_effect(baseline, item, fit) for item, fit in zip(selected, refits, strict=True)]
    hypotheses += [
        judge_proposal(before, item, walk_refits.get(item.term.key), tempering) for item in proposals
    ]
    hypotheses += [
        judge_unnamed_term(baseline, item, fit) for item, fit in zip(unnamed, unnamed_refits, strict=True)
    ]
    hypotheses = _object_to_substitutes(_drop_similar_unnamed(hypotheses, tempering))
    ordered, nothing = compute_posterior(hypotheses)
    ordered = _prefer_simple(ordered, tempering)
    stored = (*ordered[:1], *(hypothesis.without_tracking() for hypothesis in ordered[1:]))
    return Round(before.evaluation.without_cache(), stored, nothing, tuple(screened), null, tempering)


def _refit_with_common_weights(before: Refit, refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
    """Return the fits before and after under the same weights, so that their likelihoods are comparable."""
    tracked = [track_wheel_phase(fit.without_cache().state) for fit in refits]
    weights = _strictest_weights(before.evaluation.weights, [walks for _, walks in tracked])
    baseline = refit(Evaluation(before.state, weights), rounds=0)
    common = [
        fit_tracked(Evaluation(replace(state), weights), rounds=1, baseline=baseline).without_cache()
        for state, _ in tracked
    ]
    return baseline, common


def _prefer_simple(ordered: tuple[Hypothesis, ...], tempering: float) -> tuple[Hypothesis, ...]:
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
        _list_equal_scopes(ordered, chosen),
        key=lambda k: _score_scope(ordered[k], tempering),
        default=chosen,
    )
    result = list(ordered)
    result[0] = replace(ordered[chosen], probability=first.probability)
    if chosen:
        result[chosen] = replace(first, probability=ordered[chosen].probability)
    return share_between_scopes(result)


def _score_scope(one: Hypothesis, tempering: float) -> float:
    """Return ln likelihood and prior of a hypothesis, for the comparison of scopes of one effect.

    That all nodes have the same value of an effect of their own would be a coincidence.
    """
    is_coincidence = one.term.scope == ALL and one.term.effect.level == "node"
    log_prior = -one.term.effect.neg_log_prior() - (_COINCIDENCE_NATS if is_coincidence else 0.0)
    return one.determined_gain / tempering + log_prior


def share_between_scopes(ordered: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Divide the probability of the first hypothesis among scopes with equal gain on held-out samples.

    A speed measured by two wheels, for example, shows only the difference of their clocks, and either may be
    wrong. The scopes share in proportion to their priors.
    """
    scopes = _list_equal_scopes(ordered, 0)
    if len(scopes) < 2:
        return tuple(ordered)
    priors = {k: math.exp(-ordered[k].term.effect.neg_log_prior()) for k in scopes}
    total = sum(ordered[k].probability for k in scopes) / sum(priors.values())
    return tuple(
        replace(one, probability=total * priors[k]) if k in priors else one for k, one in enumerate(ordered)
    )


def _list_equal_scopes(hypotheses: Sequence[Hypothesis], index: int) -> list[int]:
    """Return the scopes of the effect of one hypothesis that gain most on held-out samples.

    Gains of as many coordinates are equal if a varying noise level could produce their difference.
    """
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
    return [k for k in scopes if best.held_out_total - hypotheses[k].held_out_total <= best.doubtful_gain]


def _object_to_substitutes(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Reject offsets and clocks that gain less than a doubtful property of the vehicle."""
    doubtful = [one.held_out_total for one in hypotheses if one.objection == DOUBTFUL_LEVEL]
    return [
        one.with_objection("gains less than an effect that is in doubt")
        if one.is_within_level and not one.objection and one.held_out_total < max(doubtful, default=0.0)
        else one
        for one in hypotheses
    ]


def _drop_similar_unnamed(hypotheses: Sequence[Hypothesis], tempering: float) -> list[Hypothesis]:
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


def _select_unnamed_terms(before: Refit, best_gain: float) -> list[UnnamedTerm]:
    """Return the few unnamed terms whose evidence is large enough compared with the best gain."""
    minimum = max(_MIN_UNNAMED_EVIDENCE, _MIN_UNNAMED_SHARE * best_gain)
    terms = find_unnamed_terms(before.evaluation)
    return [term for term in terms if term.evidence > minimum][:_MAX_UNNAMED_REFITS]


def _max_deviance(before: Refit, refits: Sequence[Refit]) -> float:
    """Return the deviance above which a fit is abandoned, because another gained more than twice as much."""
    best = min([before, *refits], key=lambda fit: fit.deviance)
    half_gain = 0.5 * (before.deviance - best.deviance)
    return before.deviance - half_gain if half_gain > _HOPELESS_DEVIANCE * best.tempering else math.inf


def _select_for_refit(
    screened: list[ScreenedCandidate],
    always_refit: Collection[tuple[str, str]],
    strictly_screened: list[ScreenedCandidate],
) -> list[ScreenedCandidate]:
    """Return the best of the screening, the requested ones, and those that explain how a lost wheel turns."""
    selected = _shortlist(screened, _MAX_REFITS)
    requested = [next(item for item in screened if item.candidate.term.key == key) for key in always_refit]
    for item in [*requested, *strictly_screened]:
        if item.candidate.term.key not in [other.candidate.term.key for other in selected]:
            selected.append(item)
    return selected


def _shortlist(screened: list[ScreenedCandidate], count: int) -> list[ScreenedCandidate]:
    """Return the best few candidates with positive evidence, with the best seed of each effect and scope.

    The best scopes of several effects come first, because a nonlinear effect gains more than its score
    promises; then other scopes of the first effect.
    """
    best: dict[tuple[str, str], ScreenedCandidate] = {}
    for item in screened:
        if item.evidence >= 0.0:
            best.setdefault(item.candidate.term.key, item)
    first_scopes: dict[str, ScreenedCandidate] = {}
    for item in best.values():
        first_scopes.setdefault(item.candidate.name, item)
    leading = list(first_scopes.values())[:_MIN_REFITTED_EFFECTS]
    others = [item for item in best.values() if item not in leading]
    # Which clock or gyro of two is wrong is decided by refits of both.
    others.sort(key=lambda item: item.candidate.name != leading[0].candidate.name)
    return [*leading, *others][:count]


def _screen_strictly(before: Refit, reject: Collection[str]) -> list[ScreenedCandidate]:
    """Screen with the declared walks if a wheel is lost.

    A large walk absorbs a wrong wheel rotation, so that its cause would gain nothing.
    """
    problem, weights = before.evaluation.problem, before.evaluation.weights
    declared_walks = {
        node.name: declared_wheel_walk(problem, node) for node in problem.nodes if node.on_wheel
    }
    if all(weights.wheel_walks[name] <= _LOST_WHEEL_RATIO * walk for name, walk in declared_walks.items()):
        return []
    screened = screen_candidates(
        replace(before.evaluation, weights=replace(weights, wheel_walks=declared_walks)),
        before.nuisance_information,
    ).candidates
    return _shortlist([item for item in screened if item.candidate.name not in reject], _MAX_STRICT_REFITS)


def _strictest_weights(weights: Weights, walks: Sequence[Mapping[str, float]]) -> Weights:
    """Return common weights for all candidates: the smallest walk of each wheel under any of them."""
    smallest_walks = {
        node: min(walk, *(other_walks[node] for other_walks in walks))
        for node, walk in weights.wheel_walks.items()
    }
    return replace(weights, wheel_walks=smallest_walks)


def _detect_scatter(
    before: Refit, reject: Collection[str]
) -> tuple[list[Proposal], dict[tuple[str, str], Refit]]:
    """Return the proposals of all scatter detectors, and the refits of those that are random walks."""
    residuals = list(before.evaluation.mean_residuals.values())
    proposals = [
        proposal
        for detect in SCATTER_DETECTORS
        for proposal in detect(residuals)
        if proposal.term.effect.name not in reject
    ]
    walks = [proposal for proposal in proposals if proposal.term.effect.is_process()]
    return proposals, {proposal.term.key: _refit_with(before, proposal, rounds=0) for proposal in walks}


def _refit_with(before: Refit, item: Proposal | UnnamedTerm, rounds: int) -> Refit:
    evaluation = before.evaluation.with_state(before.state.with_term(item.term))
    return refit(evaluation, rounds, baseline=before).without_cache()
