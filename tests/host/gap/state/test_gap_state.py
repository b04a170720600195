"""A model state and its predictions."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.state.state import stack_channels
from hubodo.gap.state.terms import ALL, ModelTerm


def test_predictions_of_a_slice_are_a_slice_of_the_predictions(evaluation):
    state = evaluation.state
    samples = {node.name: slice(100, 300) for node in state.problem.nodes}
    part = state.select(samples)
    for node in part.problem.nodes:
        expected = stack_channels(state.predictions[node.name])
        np.testing.assert_array_equal(stack_channels(part.predictions[node.name]), expected[:, 100:300])


def test_a_term_replaces_one_of_the_same_effect_and_scope(evaluation):
    state = evaluation.state.with_term(ModelTerm(BY_NAME["gyro_bias"](x=1.0), ALL))
    state = state.with_term(ModelTerm(BY_NAME["gyro_bias"](x=2.0), ALL))
    (term,) = (term for term in state.terms if term.effect.name == "gyro_bias")
    assert term.effect.x == 2.0
