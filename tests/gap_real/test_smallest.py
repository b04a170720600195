"""Smallest size that a drive shows: the gain that an effect needs in correlated residuals."""

import pytest
from smallest import demanded_gain

from hubodo.effects import BY_NAME
from hubodo.gap.judge.demands import MIN_CORRELATED_GAIN
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.state.terms import ModelTerm


@pytest.mark.parametrize(
    ("name", "max_doubt", "expected"),
    [
        ("gyro_scale_factor", 1500.0, 1500.0),
        ("time_offset", 1500.0, 10.0 * MIN_CORRELATED_GAIN),
        ("time_offset", 300.0, 300.0),
    ],
)
def test_a_property_of_the_vehicle_has_to_gain_more_than_one_of_a_drive(name, max_doubt, expected):
    gain = HeldOutGain(2000.0, 100.0, 8000.0, max_doubt)
    hypothesis = Hypothesis(ModelTerm(BY_NAME[name](), "left"), 2000.0, 1.0, 0.0, held_out_gain=gain)
    assert demanded_gain(hypothesis, 10.0) == expected
