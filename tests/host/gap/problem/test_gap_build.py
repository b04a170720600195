"""Construction of a gap problem: its nodes, its time span and saturation limits of the readings."""

import numpy as np

from hubodo.gap.problem.build import MIN_DURATION, find_saturation_limit


def test_readings_that_pile_up_at_a_value_saturate_there_and_noise_does_not():
    y = 3.0 * np.random.default_rng(1).standard_normal((3, 2000))
    assert find_saturation_limit(y) == np.inf
    assert find_saturation_limit(np.clip(y, -4.0, 4.0)) == 4.0


def test_a_problem_has_all_nodes_and_the_time_common_to_nodes_and_inputs(problem):
    assert [node.name for node in problem.nodes] == ["left", "right"]
    assert all(node.used.all() and node.on_wheel for node in problem.nodes)
    assert MIN_DURATION < problem.duration <= 60.0
