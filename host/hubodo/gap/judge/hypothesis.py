"""Hypotheses of a round: candidates judged by their gain after a refit and their evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.empirical import PREFIX
from hubodo.effects.plausibility import implausible_parameters
from hubodo.gap.judge.demands import (
    MIN_WHITENED_GAIN,
    apply_jackknife,
    chance_gain,
    doubtful_gain,
    helps_held_out,
    is_steady_when_whitened,
    is_within_level,
)
from hubodo.gap.refit.cross_validation import HeldOutGain, compute_held_out_gain
from hubodo.gap.refit.jackknife import JackknifeTest
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.prune import MODEL_IMPRECISION, count_determined
from hubodo.gap.refit.refit import compute_gain
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
# Smallest share of the gain that the plausible coordinates of an effect must have alone.
_MIN_PLAUSIBLE_SHARE = 0.5
# ln Bayes factor of a hypothesis with an objection: too little for any prior.
_OBJECTION_EVIDENCE = -50.0
UNHELPFUL = "does not help on samples to which it was not fitted"
DOUBTFUL_LEVEL = "gains no more on held-out samples than the level of the noise leaves in doubt"
_INCONSISTENT = "differs between parts of the log as noise does"
DOUBTFUL_CORRELATION = "gains no more than the correlation of the residuals leaves in doubt"


@dataclass(frozen=True)
class Baseline:
    """A fit that the hypotheses of a round extend.

    fit: without any of the hypotheses
    added_gain: gain of the effects of that fit that the model file lacks, in ln likelihood
    tempering: factor by which correlated residuals exaggerate gains
    """

    fit: Refit
    added_gain: float
    tempering: float

    @property
    def is_whitened(self) -> bool:
        """Return True if the weights contain the correlation of the noise."""
        return self.fit.evaluation.weights.is_correlated

    def chance_gain(self, surprise: float = 0.0) -> float:
        """Return the gain on held-out samples that correlated residuals produce by chance.

        surprise: as in `chance_gain`; only white weights demand less of a large one
        """
        if self.is_whitened:
            return MIN_WHITENED_GAIN * self.tempering
        return chance_gain(self.tempering, surprise)


@dataclass(frozen=True)
class Hypothesis:
    """One candidate of a round.

    gain: in ln likelihood
    evidence: ln Bayes factor against the absence of the effect
    probability: posterior among all hypotheses of its round and the null hypothesis
    state: state of the model at the end of the refit
    proposal: result of the scatter detector that proposed the effect, if one did
    held_out_gain: cross-validated over folds of time; None for effects on scatter
    objection: why it cannot be added despite its gain; "" if nothing speaks against it
    n_determined, determined_gain: number of coordinates that the log determines, and the gain of these alone
    surprise: -ln of the probability of its estimate without the effect, by the jackknife
    agreement_sigmas: estimate in units of the scatter of the estimates from parts of the log
    """

    term: ModelTerm
    gain: float
    evidence: float
    probability: float
    state: State | None = None
    proposal: Proposal | None = None
    held_out_gain: HeldOutGain | None = None
    objection: str = ""
    n_determined: int = 0
    determined_gain: float = 0.0
    surprise: float = 0.0
    agreement_sigmas: float = 0.0

    @property
    def key(self) -> tuple[str, str]:
        return self.term.key

    @property
    def held_out_total(self) -> float:
        """Return the held-out gain; 0 if it was not computed."""
        return 0.0 if self.held_out_gain is None else self.held_out_gain.total

    @property
    def is_within_level(self) -> bool:
        """Return True if a varying noise level could produce the held-out gain."""
        gain = self.held_out_gain
        return gain is not None and is_within_level(self.term, gain)

    @property
    def doubtful_gain(self) -> float:
        """Return the held-out gain that a varying noise level could produce; 0 if it was not computed."""
        gain = self.held_out_gain
        return 0.0 if gain is None else doubtful_gain(self.term, gain)

    def with_objection(self, objection: str) -> Hypothesis:
        """Return a copy with an objection, which sets its evidence to a low value."""
        return replace(self, objection=objection, evidence=min(self.evidence, _OBJECTION_EVIDENCE))

    def without_tracking(self) -> Hypothesis:
        """Return a copy without tracked wheels and clocks, which take much memory."""
        state = (
            None
            if self.state is None
            else replace(self.state, starts={}, phase_offsets={}, stamp_delays={}, measured_offsets={})
        )
        return replace(self, state=state)

    def p_value(self, null_distribution: NullDistribution) -> float:
        """Return the probability that the best of all candidates gains as much by chance."""
        return null_distribution.p_value(self.gain, len(self.term.effect.coordinates()))


def judge_effect(
    baseline: Baseline, screened: ScreenedCandidate, after: Refit, jackknife: JackknifeTest
) -> Hypothesis:
    """Judge an effect that was screened and refitted; jackknife: test of its estimate."""
    term = next(term for term in after.free_terms if term.key == screened.candidate.term.key)
    gain = _limit_gain(compute_gain(baseline.fit, after), screened.gain)
    evidence = _refit_evidence(screened, after.information(term), gain, baseline.tempering)
    return _weigh_objections(baseline, term, after, gain, evidence - term.effect.neg_log_prior(), jackknife)


def judge_proposal(baseline: Baseline, proposal: Proposal, walk_refit: Refit | None) -> Hypothesis:
    """Judge a proposal of a scatter detector.

    A random walk is judged by its refit like other effects, with free wheel angles, and must gain what is
    demanded of a drift on which the parts of the log disagree. The bank of a road follows any slow noise of
    the accelerometers across, so that it is none where the weights contain such noise.
    """
    gain = proposal.gain if walk_refit is None else compute_gain(baseline.fit, walk_refit)
    tempering = 1.0 if proposal.is_exact else baseline.tempering
    evidence = gain / tempering - (proposal.gain - proposal.evidence)
    hypothesis = Hypothesis(proposal.term, gain, evidence, 0.0, None, proposal)
    is_bank = proposal.term.effect.bank_process()[0] > 0.0
    if baseline.is_whitened and is_bank:
        return hypothesis.with_objection(DOUBTFUL_CORRELATION)
    if walk_refit is not None and not is_bank and gain < baseline.chance_gain():
        return hypothesis.with_objection(DOUBTFUL_CORRELATION)
    return hypothesis


def judge_unnamed_term(baseline: Baseline, unnamed: UnnamedTerm, after: Refit) -> Hypothesis:
    """Judge an unnamed term that was refitted."""
    term = next(term for term in after.free_terms if term.key == unnamed.term.key)
    gain = _limit_gain(compute_gain(baseline.fit, after), unnamed.gain)
    evidence = gain / baseline.tempering - (unnamed.gain - unnamed.evidence)
    return _weigh_objections(baseline, term, after, gain, evidence, apply_jackknife(after, term.key))


def _weigh_objections(
    baseline: Baseline,
    term: ModelTerm,
    after: Refit,
    gain: float,
    evidence: float,
    jackknife: JackknifeTest,
) -> Hypothesis:
    """Return the hypothesis, with little evidence if it is implausible or fails on held-out samples."""
    tempering = baseline.tempering
    held_out_gain = compute_held_out_gain(baseline.fit.fold_deviances, after.fold_deviances)
    count, loss = count_determined(after, term, tempering, baseline.added_gain + gain)
    surprise = jackknife.surprise
    hypothesis = Hypothesis(
        term,
        gain,
        evidence,
        probability=0.0,
        state=after.evaluation.without_cache().state,
        held_out_gain=held_out_gain,
        n_determined=count,
        determined_gain=gain - loss,
        surprise=surprise,
        agreement_sigmas=jackknife.agreement_sigmas,
    )
    if _plausible_share(term, after) < _MIN_PLAUSIBLE_SHARE:
        return hypothesis.with_objection(_describe_implausible(term, after))
    if not helps_held_out(gain, held_out_gain, tempering):
        return hypothesis.with_objection(UNHELPFUL)
    if baseline.is_whitened and not is_steady_when_whitened(jackknife, held_out_gain):
        return hypothesis.with_objection(_INCONSISTENT)
    demanded = held_out_gain
    if not term.effect.name.startswith(PREFIX):
        # An effect may take over what differences of the given ones explain without it.
        doubt = max(MODEL_IMPRECISION**2 * baseline.added_gain, baseline.fit.given_gain, after.given_gain)
        demanded = replace(held_out_gain, max_doubt=max(doubt, baseline.chance_gain(surprise)))
        in_doubt = replace(held_out_gain, max_doubt=max(doubt, baseline.chance_gain()))
        hypothesis = replace(hypothesis, held_out_gain=in_doubt)
    if not is_within_level(term, demanded):
        return hypothesis
    if not term.effect.varies_between_drives:
        return hypothesis.with_objection(DOUBTFUL_LEVEL)
    is_chance = held_out_gain.total < baseline.chance_gain(surprise)
    return hypothesis.with_objection(DOUBTFUL_CORRELATION) if is_chance else hypothesis


def _plausible_share(term: ModelTerm, after: Refit) -> float:
    """Return the share of an effect's gain that its plausible coordinates have alone."""
    implausible = _list_implausible(term, after)
    if not implausible:
        return 1.0
    information = after.information(term)
    value = term.effect.coordinates() / term.effect.coordinate_scales()
    names = term.effect.fitted_parameters()
    if len(names) != len(value) or len(value) == len(implausible):
        return 0.0
    is_plausible = np.array([name not in implausible for name in names])
    slope = information @ value
    own = (
        slope[is_plausible]
        @ np.linalg.pinv(information[np.ix_(is_plausible, is_plausible)], hermitian=True)
        @ slope[is_plausible]
    )
    return float(own / max(value @ slope, 1e-12))


def _list_implausible(term: ModelTerm, after: Refit) -> dict[str, float]:
    """Return the parameters at their plausible limit, a single one within 1 sigma of it, with the limit."""
    effect, variance = term.effect, np.diag(after.robust_covariance)[after.coordinate_slice(term)]
    coordinates = effect.coordinates()
    if len(coordinates) > 1:
        return implausible_parameters(effect)
    margin = np.copysign(np.sqrt(np.maximum(variance, 0.0)) * effect.coordinate_scales(), coordinates)
    return implausible_parameters(effect.with_coordinates(coordinates + margin))


def _describe_implausible(term: ModelTerm, after: Refit) -> str:
    name, bound = next(iter(_list_implausible(term, after).items()))
    value, unit = term.effect.values()[name], term.effect.unit(name)
    limit = f"{name} = {value:.2g} {unit} at its limit of ±{bound:.2g}"
    return f"not physical: {limit}; another cause looks like this"


def _limit_gain(gain: float, promised: float) -> float:
    return min(gain, _MAX_GAIN_RATIO * promised + _MAX_EXTRA_GAIN)


def _refit_evidence(screened: ScreenedCandidate, information: Array, gain: float, tempering: float) -> float:
    """Return the ln Bayes factor of an effect after its refit.

    The linear model at the candidate's start determines which coordinates are at work; coordinates
    unobservable there (such as the time constant of zero) are penalised at the end of the refit.
    """
    linear_evidence = compute_log_evidence(
        screened.gain / tempering, screened.coordinates, screened.information / tempering
    )
    newly_observed = (np.diag(screened.information) <= 0.0) & (np.diag(information) > 0.0)
    penalty = 0.5 * float(np.sum(np.log1p(USUAL_SCALE**2 * np.diag(information)[newly_observed] / tempering)))
    return linear_evidence + (gain - screened.gain) / tempering - penalty
