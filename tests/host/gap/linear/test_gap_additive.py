"""Effects that only add to the readings."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.linear.additive import AdditiveEffects, changes_only_geometry


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


def test_a_gyro_depends_on_force_only_with_an_effect_that_couples_them(evaluation):
    state = evaluation.state
    node = state.problem.nodes[0]
    sensitivity = BY_NAME["gyro_g_sensitivity"](z=1e-3)
    effects = {**state.effects[node.name], **{type(one): one for one in [BY_NAME["accel_bias"](x=0.1)]}}
    chain = state.sensor_chain(node)
    assert not AdditiveEffects(chain, effects).gyro_depends_on_force
    assert AdditiveEffects(chain, {**effects, type(sensitivity): sensitivity}).gyro_depends_on_force


def test_a_lever_arm_changes_only_the_geometry_and_a_clock_does_not():
    assert changes_only_geometry(BY_NAME["lever_arm"])
    assert not changes_only_geometry(BY_NAME["time_offset"])
