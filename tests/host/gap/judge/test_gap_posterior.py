"""The posterior over all hypotheses and the null hypothesis."""

import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.posterior import compute_posterior
from hubodo.gap.state.terms import ModelTerm


def test_probabilities_sum_to_one_and_follow_the_evidence():
    pairs = (("gyro_bias", 30.0), ("wheel_camber", 35.0), ("lever_arm", -5.0))
    hypotheses = [Hypothesis(ModelTerm(BY_NAME[name](), "left"), ev, ev, 0.0) for name, ev in pairs]
    ordered, p_null = compute_posterior(hypotheses)
    assert [it.term.effect.name for it in ordered] == ["wheel_camber", "gyro_bias", "lever_arm"]
    assert sum(it.probability for it in ordered) + p_null == pytest.approx(1.0)


def test_without_evidence_the_null_hypothesis_wins():
    hypothesis = Hypothesis(ModelTerm(BY_NAME["gyro_bias"](), "left"), 0.1, -4.0, 0.0)
    assert compute_posterior([hypothesis])[1] > 0.99
