"""Confidence of a finding."""

from types import SimpleNamespace

from hubodo.gap.explain.finding import _limit_confidence

STRONG_HYPOTHESIS, WEAK_HYPOTHESIS = SimpleNamespace(gain=500.0), SimpleNamespace(gain=20.0)


def test_confidence_is_limited_if_another_effect_fits_as_well_or_the_gain_is_small():
    assert _limit_confidence(0.999, STRONG_HYPOTHESIS, {"lever_arm": 100.0}, False) == 0.999
    assert _limit_confidence(0.999, STRONG_HYPOTHESIS, {"lever_arm": -10.0}, False) <= 0.8
    assert _limit_confidence(0.999, STRONG_HYPOTHESIS, {"lever_arm": 100.0}, True) <= 0.8
    assert _limit_confidence(0.999, WEAK_HYPOTHESIS, {"lever_arm": 100.0}, False) < 0.999
