"""Hypotheses of a round."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.state.terms import ModelTerm


def test_a_larger_gain_is_less_likely_by_chance():
    null = NullDistribution(np.sort(np.random.default_rng(8).exponential(2.0, 400)))
    term = ModelTerm(BY_NAME["gyro_bias"](), "left")
    faint, strong = (Hypothesis(term, gain, gain, 0.0).p_value(null) for gain in (4.0, 40.0))
    assert strong < 1e-3 < faint


def test_a_copy_without_tracking_has_the_terms_and_no_tracked_wheels(evaluation):
    term = ModelTerm(BY_NAME["gyro_bias"](), "left")
    copy = Hypothesis(term, 1.0, 1.0, 0.5, evaluation.state).without_tracking()
    assert copy.state.terms == evaluation.state.terms
    assert not copy.state.phase_offsets and evaluation.state.phase_offsets
