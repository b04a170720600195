"""Coupling of nodes by a speed that their gyros measure; a speed reference does not couple them."""

from hubodo.effects import BY_NAME
from hubodo.gap.linear.shared_speed import SpeedCoupling


def test_with_a_reference_no_effect_changes_the_speed(evaluation):
    state, effect = evaluation.state, BY_NAME["gyro_bias"](z=0.1)
    effects = {**state.effects, "left": {type(effect): effect}}
    assert SpeedCoupling(state).correction_slope(effects, effect, ["left"], 1.0) is None
