"""Comparison of hypotheses: scopes fold by fold, and offsets beside effects in doubt."""

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import empirical_class
from hubodo.gap.judge.comparison import object_to_substitutes, object_to_walks, share_between_scopes
from hubodo.gap.judge.hypothesis import DOUBTFUL_LEVEL, Hypothesis
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.scatter import Proposal
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm


@pytest.mark.parametrize(
    ("other_folds", "tempering", "shares"),
    [
        ([400.0] * 10, 3.5, (1.0, 0.0)),
        ([400.0] * 10, 8.0, (0.5, 0.5)),
        ([425.0] * 10, 3.5, (0.5, 0.5)),
        ([100.0, 640.0] * 4 + [640.0, 400.0], 3.5, (0.5, 0.5)),
    ],
)
def test_a_scope_that_gains_more_in_nearly_all_folds_does_not_share_its_probability(
    problem, other_folds, tempering, shares
):
    """The advantage in total is 300, 50 or 300, of which 45 times the tempering are due to correlation."""

    def judge(node, folds, probability):
        gain = HeldOutGain(sum(folds), 1.0, 3000.0, np.inf, tuple(folds))
        term = ModelTerm(BY_NAME["clock_skew"](100.0), node)
        return Hypothesis(term, gain.total, 1.0, probability, State(problem), held_out_gain=gain)

    hypotheses = [judge("left", [430.0] * 10, 1.0), judge("right", other_folds, 0.0)]
    assert tuple(one.probability for one in share_between_scopes(hypotheses, tempering)) == shares


@pytest.mark.parametrize(
    ("kind", "is_rejected"),
    [
        (BY_NAME["gyro_nonorthogonality"], True),
        (empirical_class("empirical:gz ~ spin^2*harmonics(theta)"), False),
    ],
)
def test_an_offset_stands_in_for_a_listed_effect_in_doubt_but_not_for_an_unnamed_term(kind, is_rejected):
    """A term of many coordinates gains more than an offset in any noise with structure."""
    gain = HeldOutGain(2000.0, 100.0, 9000.0)
    other = Hypothesis(
        ModelTerm(kind(), "left"), 2000.0, 1.0, 0.0, held_out_gain=gain, objection=DOUBTFUL_LEVEL
    )
    offset = Hypothesis(
        ModelTerm(BY_NAME["time_offset"](0.01), "left"),
        1500.0,
        1.0,
        0.0,
        held_out_gain=HeldOutGain(1500.0, 100.0, 9000.0),
    )
    judged = object_to_substitutes([other, offset])[1]
    assert bool(judged.objection) is is_rejected


@pytest.mark.parametrize(
    ("gain", "surprise", "tempering", "is_rejected"),
    [
        (2476.0, 33.0, 3.5, True),
        (2476.0, 5.0, 3.5, False),
        (2300.0, 33.0, 3.5, False),
        (2476.0, 33.0, 1.0, False),
    ],
)
def test_a_random_walk_gives_way_to_an_effect_on_which_the_parts_of_a_correlated_log_agree(
    gain, surprise, tempering, is_rejected
):
    walk = Hypothesis(ModelTerm(BY_NAME["gyro_rate_random_walk"](k=4e-4), "right"), 2472.0, 701.0, 0.0)
    term = ModelTerm(BY_NAME["node_misalignment"](), "right")
    steady = Hypothesis(term, gain, 696.0, 0.0, surprise=surprise)
    judged = object_to_walks([walk, steady], tempering)
    assert bool(judged[0].objection) == is_rejected
    assert judged[1] == steady


@pytest.mark.parametrize(
    ("advantage", "tempering", "is_rejected"),
    [(6.0, 3.5, True), (3.0, 3.5, False), (-40.0, 3.5, False), (6.0, 1.0, False)],
)
def test_a_random_walk_in_correlated_residuals_gives_way_to_a_smooth_drift_that_gains_more(
    advantage, tempering, is_rejected
):
    """The detector charges the drift for its parameters, which suffices in white noise."""
    term = ModelTerm(BY_NAME["gyro_rate_random_walk"](k=4e-4), "right")
    proposal = Proposal(term, 700.0, 690.0, {}, "", smooth_advantage=advantage)
    walk = Hypothesis(term, 2472.0, 701.0, 0.0, proposal=proposal)
    assert bool(object_to_walks([walk], tempering)[0].objection) == is_rejected
