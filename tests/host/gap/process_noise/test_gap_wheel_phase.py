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


def test_a_steady_drift_of_the_phase_is_part_of_the_walk_only_if_wheels_are_not_steady(problem):
    node = problem.nodes[0]
    drift = 0.01 * (node.t - node.t[0])
    measured = node.forward.mean_reading((), NodeInitialState(), drift)
    node = replace(node, y=stack_channels(measured))
    phases = estimate_phases(node, node.forward.mean_reading((), NodeInitialState()), None, 0.01)
    smoothed, walk = smooth_phases(phases, 1e-8)
    steady_smoothed, steady_walk = smooth_phases(phases, 1e-8, is_steady=True)
    assert steady_walk == pytest.approx(1e-8)
    assert walk > 100.0 * steady_walk
    np.testing.assert_allclose(steady_smoothed, 0.01 * (phases.t - node.t[0]), atol=2e-3)
    # Without trends a walk is expected to stay where it is, and lags at the ends.
    np.testing.assert_allclose(smoothed[2:-2], 0.01 * (phases.t - node.t[0])[2:-2], atol=5e-3)
