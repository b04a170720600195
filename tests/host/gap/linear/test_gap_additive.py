"""Effects that only add to the readings."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.linear.additive import AdditiveEffects


def test_a_bias_is_additive_and_camber_is_not(evaluation):
    state = evaluation.state
    node = state.problem.nodes[0]
    additive_effects = AdditiveEffects(state.sensor_chain(node), state.effects[node.name])
    bias = BY_NAME["gyro_bias"](x=0.01)
    assert additive_effects.is_additive(type(bias)) and not additive_effects.is_additive(
        BY_NAME["wheel_camber"]
    )
    change = additive_effects.reading_change(bias)
    np.testing.assert_allclose(change[0], 0.01)
    assert not change[1:].any()
