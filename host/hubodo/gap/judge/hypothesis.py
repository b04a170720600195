"""Hypotheses of a round: candidates judged by their gain after a refit and their evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.refit.refit import Refit, compute_gain
from hubodo.gap.scatter import Proposal
from hubodo.gap.screen.evidence import USUAL_SCALE, compute_log_evidence
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.screen.screening import ScreenedCandidate
from hubodo.gap.screen.unnamed_terms import UnnamedTerm
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm

# Gain of a refit is limited to this many times that of the linear model plus this ln likelihood: more comes
# from another optimum than the candidate's own. Chosen; judged by `make gap-matrix`.
_MAX_GAIN_RATIO, _MAX_EXTRA_GAIN = 20.0, 20.0


@dataclass(frozen=True)
class Hypothesis:
    """One candidate of a round.

    gain: in ln likelihood
    evidence: ln Bayes factor against its absence
    probability: posterior among all hypotheses of its round and the null hypothesis
    state: at the end of its refit
    proposal: of a scatter detector
    """

    term: ModelTerm
    gain: float
    evidence: float
    probability: float
    state: State | None = None
    proposal: Proposal | None = None

    @property
    def key(self) -> tuple[str, str]:
        return self.term.key

    def without_tracking(self) -> Hypothesis:
        """Return a copy without tracked wheels and clocks, which take much memory."""
        state = (
            None if self.state is None else replace(self.state, starts={}, phase_offsets={}, stamp_delays={})
        )
        return replace(self, state=state)

    def p_value(self, null_distribution: NullDistribution) -> float:
        """Return how often the best candidate would gain as much by chance."""
        return null_distribution.p_value(self.gain, len(self.term.effect.coordinates()))


def judge_effect(before: Refit, screened: ScreenedCandidate, after: Refit, tempering: float) -> Hypothesis:
    """Judge an effect that was screened and refitted."""
    term = next(term for term in after.free_terms if term.key == screened.candidate.term.key)
    gain = _limit_gain(compute_gain(before, after), screened.gain)
    evidence = (
        _refit_evidence(screened, after.information(term), gain, tempering) - term.effect.neg_log_prior()
    )
    return Hypothesis(term, gain, evidence, 0.0, after.evaluation.without_cache().state)


def judge_proposal(
    before: Refit, proposal: Proposal, walk_refit: Refit | None, tempering: float
) -> Hypothesis:
    """Judge a proposal of a scatter detector.

    A random walk is judged by its refit like other effects, with free wheel angles.
    """
    gain = proposal.gain if walk_refit is None else compute_gain(before, walk_refit)
    evidence = gain / tempering - (proposal.gain - proposal.evidence)
    return Hypothesis(proposal.term, gain, evidence, 0.0, None, proposal)


def judge_unnamed_term(before: Refit, unnamed: UnnamedTerm, after: Refit, tempering: float) -> Hypothesis:
    """Judge an unnamed term that was refitted."""
    term = next(term for term in after.free_terms if term.key == unnamed.term.key)
    gain = _limit_gain(compute_gain(before, after), unnamed.gain)
    evidence = gain / tempering - (unnamed.gain - unnamed.evidence)
    return Hypothesis(term, gain, evidence, 0.0, after.evaluation.without_cache().state)


def _limit_gain(gain: float, promised: float) -> float:
    return min(gain, _MAX_GAIN_RATIO * promised + _MAX_EXTRA_GAIN)


def _refit_evidence(screened: ScreenedCandidate, information: Array, gain: float, tempering: float) -> float:
    """Return ln Bayes factor after the refit.

    The linear model at the candidate's start determines which coordinates are at work; coordinates
    unobservable there (such as the time constant of zero) are penalised at the end of the refit.
    """
    linear_evidence = compute_log_evidence(
        screened.gain / tempering, screened.coordinates, screened.information / tempering
    )
    newly_observed = (np.diag(screened.information) <= 0.0) & (np.diag(information) > 0.0)
    penalty = 0.5 * float(np.sum(np.log1p(USUAL_SCALE**2 * np.diag(information)[newly_observed] / tempering)))
    return linear_evidence + (gain - screened.gain) / tempering - penalty
