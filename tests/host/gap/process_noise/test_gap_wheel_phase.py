"""Estimation of the wheel phase from the direction of gravity."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.gap.process_noise.wheel_phase import estimate_phases, smooth_phases
from hubodo.gap.state.state import stack_channels
from hubodo.model.forward import NodeInitialState

PHASE_OFFSET = 0.3  # rad


@pytest.mark.parametrize("index", [0, 1])
def test_a_phase_offset_is_estimated_on_either_side(problem, index):
    node = problem.nodes[index]
    reading_with_offset = node.forward.mean_reading((), NodeInitialState(PHASE_OFFSET))
    node = replace(node, y=stack_channels(reading_with_offset))
    phases = estimate_phases(node, node.forward.mean_reading((), NodeInitialState()), None, 0.01)
    np.testing.assert_allclose(phases.phase, PHASE_OFFSET, atol=2e-3)
    smoothed_phase, walk = smooth_phases(phases, 1e-8)
    np.testing.assert_allclose(smoothed_phase, PHASE_OFFSET, atol=2e-3)
    assert walk == pytest.approx(1e-8)
