"""Hypotheses of a search round."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.judge.hypothesis import Hypothesis
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
