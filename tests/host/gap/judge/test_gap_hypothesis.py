"""Hypotheses of a search round."""

from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge.hypothesis import Baseline, Hypothesis, judge_proposal
from hubodo.gap.scatter import Proposal
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.state.terms import ModelTerm


def test_a_larger_gain_is_less_likely_by_chance():
    null = NullDistribution(np.sort(np.random.default_rng(8).exponential(2.0, 400)))
    term = ModelTerm(BY_NAME["gyro_bias"](), "left")
    p_weak, p_strong = (Hypothesis(term, gain, gain, 0.0).p_value(null) for gain in (4.0, 40.0))
    assert p_strong < 1e-3 < p_weak


def test_a_copy_without_tracking_keeps_the_terms_and_drops_the_phase_offsets(evaluation):
    term = ModelTerm(BY_NAME["gyro_bias"](), "left")
    untracked = Hypothesis(term, 1.0, 1.0, 0.5, evaluation.state).without_tracking()
    assert untracked.state.terms == evaluation.state.terms
    assert not untracked.state.phase_offsets and evaluation.state.phase_offsets


def build_baseline(is_correlated, tempering):
    """Return a fake of a baseline without effects, under white weights or such with correlation."""
    weights = SimpleNamespace(is_correlated=is_correlated)
    return Baseline(SimpleNamespace(evaluation=SimpleNamespace(weights=weights)), 0.0, tempering)


def test_weights_with_correlation_demand_a_gain_at_any_tempering():
    white, whitened = (build_baseline(is_correlated, 1.2) for is_correlated in (False, True))
    assert white.chance_gain() == 0.0
    assert whitened.chance_gain() == whitened.chance_gain(16.0) == 30.0 * 1.2


@pytest.mark.parametrize("gain", [40.0, 400.0])
def test_a_bank_is_named_under_white_weights_alone(gain):
    """It follows slow noise of the accelerometers; white weights leave that to the tempering."""
    bank = ModelTerm(BY_NAME["road_bank"](sigma=0.01, length=80.0), "vehicle")
    proposal = Proposal(bank, gain, gain - 5.0, {}, "")
    assert judge_proposal(build_baseline(True, 1.0), proposal, None).objection
    assert not judge_proposal(build_baseline(False, 1.0), proposal, None).objection
    outliers = Proposal(ModelTerm(BY_NAME["outliers"](), "left"), 40.0, 35.0, {}, "")
    assert not judge_proposal(build_baseline(True, 1.0), outliers, None).objection


def test_correlated_residuals_temper_no_evidence_of_equal_readings():
    repeats = ModelTerm(BY_NAME["sample_repeat"](), "left")
    exact, inexact = (Proposal(repeats, 40.0, 35.0, {}, "", is_exact) for is_exact in (True, False))
    baseline = build_baseline(False, 8.0)
    assert judge_proposal(baseline, exact, None).evidence == 35.0
    assert judge_proposal(baseline, inexact, None).evidence == 40.0 / 8.0 - 5.0
