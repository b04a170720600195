"""Error of a speed measured by a gyro on a wheel."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.state.measured_speed import average_speed_errors, compute_speed_error


def test_a_gyro_without_errors_needs_no_speed_correction(problem):
    error = compute_speed_error(problem.nodes[0], {}, False)
    np.testing.assert_allclose(error.correction, 0.0, atol=1e-9)


def test_a_bias_corrects_the_speed_by_bias_times_radius_and_by_half_of_it_with_two_wheels(problem):
    nodes, bias = problem.nodes, BY_NAME["gyro_bias"](z=0.1)
    error = compute_speed_error(nodes[0], {type(bias): bias}, False).correction
    np.testing.assert_allclose(np.abs(error), 0.1 * nodes[0].forward.wheel_radius, rtol=1e-6)
    np.testing.assert_allclose(average_speed_errors(nodes, {nodes[0].name: error}), 0.5 * error)
