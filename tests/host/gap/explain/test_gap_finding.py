"""Confidence of a finding."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.explain.finding import (
    _join_covariances,
    _limit_confidence,
    _list_equal_scopes,
)
from hubodo.gap.judge.comparison import share_between_scopes
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.state.terms import ModelTerm

STATE = SimpleNamespace()
STRONG_HYPOTHESIS, WEAK_HYPOTHESIS = SimpleNamespace(gain=500.0), SimpleNamespace(gain=20.0)


def test_confidence_is_limited_if_another_effect_fits_as_well_or_the_gain_is_small():
    assert _limit_confidence(0.999, STRONG_HYPOTHESIS, {"lever_arm": 100.0}, False) == 0.999
    assert _limit_confidence(0.999, STRONG_HYPOTHESIS, {"lever_arm": -10.0}, False) <= 0.8
    assert _limit_confidence(0.999, STRONG_HYPOTHESIS, {"lever_arm": 100.0}, True) <= 0.8
    assert _limit_confidence(0.999, WEAK_HYPOTHESIS, {"lever_arm": 100.0}, False) < 0.999


def test_scopes_that_share_the_probability_are_listed():
    rows = (("time_offset", "left", 0.5), ("time_offset", "right", 0.5), ("time_offset", "all", 0.0))
    hypotheses = [
        Hypothesis(ModelTerm(BY_NAME[name](), scope), 1.0, 1.0, probability)
        for name, scope, probability in (*rows, ("clock_skew", "left", 0.5))
    ]
    assert [one.term.scope for one in _list_equal_scopes(hypotheses, hypotheses[1])] == ["left", "right"]
    assert _list_equal_scopes(hypotheses, hypotheses[2]) == []
    assert _list_equal_scopes(hypotheses, None) == []


def test_scopes_share_the_probability_though_the_priors_of_their_values_differ():
    """Only the difference of two gyros is known: a smaller warm-up of both is as likely as one of either."""
    values = {"left": 0.055, "right": 0.06, "all": 0.028}
    hypotheses = [
        Hypothesis(
            ModelTerm(BY_NAME["gyro_warmup"](z=z, time_constant=t), scope), 1e4, 500.0, 1.0, state=STATE
        )
        for (scope, z), t in zip(values.items(), (24.0, 30.0, 25.5), strict=True)
    ]
    held_out = HeldOutGain(1e4, 100.0, 9e3, 3e3)
    shared = share_between_scopes([replace(one, held_out_gain=held_out) for one in hypotheses], 3.5)
    assert len({one.probability for one in shared}) > 1
    assert {one.term.scope for one in _list_equal_scopes(shared, shared[0])} == set(values)


def test_joined_covariances_have_the_largest_variance_of_each_coordinate_and_the_correlation_of_the_largest():
    narrow, wide = np.array([[4.0, 1.0], [1.0, 1.0]]), np.array([[1.0, -1.5], [-1.5, 9.0]])
    covariance = _join_covariances([narrow, wide, np.zeros((2, 2))])
    np.testing.assert_allclose(np.diag(covariance), [4.0, 9.0])
    assert covariance[0, 1] / 6.0 == pytest.approx(-0.5)
