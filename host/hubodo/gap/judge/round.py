"""One round of the search: screen all candidates, refit the best, judge them together."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.comparison import (
    drop_similar_unnamed,
    object_to_substitutes,
    object_to_walks,
    prefer_simple,
)
from hubodo.gap.judge.demands import CONSISTENT_SURPRISE, apply_jackknife, helps_held_out
from hubodo.gap.judge.hypothesis import Baseline, Hypothesis, judge_effect, judge_proposal, judge_unnamed_term
from hubodo.gap.judge.posterior import compute_posterior
from hubodo.gap.judge.shortlist import screen_strictly, select_for_refit
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.process_noise.weights import Weights
from hubodo.gap.refit.cross_validation import compute_held_out_gain
from hubodo.gap.refit.jackknife import JackknifeTest
from hubodo.gap.refit.linear_fit import Refit, linearise_fit
from hubodo.gap.refit.refit import compute_added_gain, compute_gain, continue_fit, fit_tracked, refit
from hubodo.gap.scatter import SCATTER_DETECTORS, Proposal
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.screen.screening import ScreenedCandidate, screen_candidates
from hubodo.gap.screen.unnamed_terms import UnnamedTerm, find_unnamed_terms

# Name for `--reject` that excludes all unnamed terms.
EMPIRICAL = "empirical"
# Settings of the search; chosen, and judged together by `make gap-matrix`.
# Posterior probability that anything is missing, from which on an effect is added.
MIN_ADD_PROBABILITY = 0.99
# Half of the best gain, in deviance per tempering, from which on candidates with less are abandoned.
_HOPELESS_DEVIANCE = 100.0
# Unnamed terms to refit; share of the best gain, and evidence as ln Bayes factor, that each has to reach.
_MAX_UNNAMED_REFITS, _MIN_UNNAMED_SHARE, _MIN_UNNAMED_EVIDENCE = 2, 0.25, 3.0
# ln Bayes factor for independent samples, from which on an effect is added provisionally.
_PROVISIONAL_EVIDENCE = 20.0
# Ratio of the gain of a random walk to that of the best steady effect, from which on it is the better model.
_MIN_WALK_ADVANTAGE = 2.0
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
        every gain. Returned is the hypothesis that would be added if the residuals were white, unless it is
        without a name, or a random walk, which would take over what several others explain. Evidence of equal
        readings is not tempered.
        """
        if self.best is not None or not self.hypotheses:
            return None
        first = self.hypotheses[0]
        untempered_evidence = first.evidence + first.gain * (1.0 - 1.0 / self.tempering)
        can_be_hidden = not (
            first.term.effect.name.startswith(PREFIX)
            or first.term.effect.random_walk_variance_rate() > 0.0
            or (first.proposal is not None and first.proposal.is_exact)
        )
        is_hidden = first.evidence > 0.0 and untempered_evidence > _PROVISIONAL_EVIDENCE
        return first if can_be_hidden and is_hidden else None

    def find_hypothesis(self, key: tuple[str, str]) -> Hypothesis | None:
        """Return the hypothesis of this effect and scope, or None."""
        return next((hypothesis for hypothesis in self.hypotheses if hypothesis.key == key), None)


RoundsByKey = Mapping[tuple[str, str], Round]
"""The round that judged each effect and scope."""


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
    strictly_screened = screen_strictly(before, reject)
    screening = screen_candidates(before.evaluation, before.nuisance_information)
    screened = [item for item in screening.candidates if item.candidate.name not in reject]
    selected = select_for_refit(screened, always_refit, strictly_screened)
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
    jackknives = [
        apply_jackknife(fit, item.candidate.term.key) for item, fit in zip(selected, refits, strict=True)
    ]
    steady = _list_steady(before, refits, jackknives)
    tempering = _choose_tempering(before, steady, list(walk_refits.values()), [*refits, *unnamed_refits])
    baseline = Baseline(before, compute_added_gain(before), tempering)
    hypotheses = [
        judge_effect(baseline, *candidate) for candidate in zip(selected, refits, jackknives, strict=True)
    ]
    hypotheses += [judge_proposal(baseline, item, walk_refits.get(item.term.key)) for item in proposals]
    hypotheses += [
        judge_unnamed_term(baseline, item, fit) for item, fit in zip(unnamed, unnamed_refits, strict=True)
    ]
    hypotheses = object_to_substitutes(drop_similar_unnamed(hypotheses, tempering))
    ordered, nothing = compute_posterior(object_to_walks(hypotheses, tempering))
    ordered = prefer_simple(ordered, tempering)
    stored = (*ordered[:1], *(hypothesis.without_tracking() for hypothesis in ordered[1:]))
    return Round(before.evaluation.without_cache(), stored, nothing, tuple(screened), null, tempering)


def _list_steady(before: Refit, refits: Sequence[Refit], jackknives: Sequence[JackknifeTest]) -> list[Refit]:
    """Return the fits of effects whose estimates from parts of the log agree, and predict the other parts."""
    return [
        fit
        for fit, jackknife in zip(refits, jackknives, strict=True)
        if jackknife.surprise >= CONSISTENT_SURPRISE
        and helps_held_out(
            compute_gain(before, fit), compute_held_out_gain(before.fold_deviances, fit.fold_deviances)
        )
    ]


def _choose_tempering(
    before: Refit, steady: Sequence[Refit], walks: Sequence[Refit], others: Sequence[Refit]
) -> float:
    """Return by how much correlation inflates the gains, from the block scores of the best fit.

    steady, walks: fits of effects on which the parts of the log agree, and of random walks

    Steady effects come first: a drift that gains a little more in correlated residuals says nothing about
    them. If a random walk gains more than twice as much, it is they that follow a part of the drift.
    """
    if not (steady or walks or others):
        return 1.0
    best = min(steady or [*walks, *others], key=lambda fit: fit.deviance)
    walk = min(walks, key=lambda fit: fit.deviance, default=best)
    is_walk = compute_gain(before, walk) > _MIN_WALK_ADVANTAGE * compute_gain(before, best)
    return (walk if is_walk else best).tempering


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
