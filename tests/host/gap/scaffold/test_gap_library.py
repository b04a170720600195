"""The library of expressions for new effects."""

import numpy as np

from hubodo.gap.scaffold.library import build_bump, build_step, build_tone, list_shapes
from hubodo.gap.screen.unnamed_terms import build_chain


def test_each_shape_has_a_finite_value_for_each_sample_and_amplitude(evaluation):
    node = evaluation.problem.nodes[0]
    chain = build_chain(node, evaluation.state.predictions[node.name])
    localised = [build_tone(1.3, 60.0), build_step(20.0), build_bump(1.0, 0.2, "1.0")]
    for shape in [*list_shapes(), *localised]:
        values = shape.columns(chain)
        assert values.shape == (len(shape.amplitudes), len(node.t)) and np.isfinite(values).all()
