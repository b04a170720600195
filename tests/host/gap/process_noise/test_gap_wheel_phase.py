"""The wheel angle from the direction of gravity."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.gap.process_noise.wheel_phase import estimate_phases, smooth_phases
from hubodo.gap.state.state import stack_channels
from hubodo.model.forward import NodeInitialState

AHEAD = 0.3  # rad


@pytest.mark.parametrize("index", [0, 1])
def test_a_wheel_that_is_ahead_of_the_model_is_seen_ahead_by_as_much_on_either_side(problem, index):
    node = problem.nodes[index]
    true = node.forward.mean_reading((), NodeInitialState(AHEAD))
    node = replace(node, y=stack_channels(true))
    phases = estimate_phases(node, node.forward.mean_reading((), NodeInitialState()), None, 0.01)
    np.testing.assert_allclose(phases.phase, AHEAD, atol=2e-3)
    path, walk = smooth_phases(phases, 1e-8)
    np.testing.assert_allclose(path, AHEAD, atol=2e-3)
    assert walk == pytest.approx(1e-8)
