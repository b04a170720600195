"""A speed that a gyro measures, and its error."""

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.state.measured_speed import average_speed_errors, compute_speed_error


def test_a_gyro_without_errors_measures_the_speed_of_its_contact_point(problem):
    error = compute_speed_error(problem.nodes[0], {}, False)
    np.testing.assert_allclose(error.correction, 0.0, atol=1e-9)


def test_a_bias_is_corrected_by_the_radius_times_it_and_half_as_much_with_another_wheel(problem):
    nodes, bias = problem.nodes, BY_NAME["gyro_bias"](z=0.1)
    error = compute_speed_error(nodes[0], {type(bias): bias}, False).correction
    np.testing.assert_allclose(np.abs(error), 0.1 * nodes[0].forward.wheel_radius, rtol=1e-6)
    np.testing.assert_allclose(average_speed_errors(nodes, {nodes[0].name: error}), 0.5 * error)
