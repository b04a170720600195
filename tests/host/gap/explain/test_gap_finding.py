"""Confidence of a finding."""

from types import SimpleNamespace

from hubodo.effects import BY_NAME
from hubodo.gap.explain.finding import _limit_confidence, _list_equal_scopes
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.state.terms import ModelTerm

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
    assert _list_equal_scopes(hypotheses, hypotheses[1]) == ["left", "right"]
    assert _list_equal_scopes(hypotheses, hypotheses[2]) == []
    assert _list_equal_scopes(hypotheses, None) == []
