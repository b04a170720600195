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
    average = average_speed_errors(nodes, np.full((2, 1), 0.5), {nodes[0].name: error})
    np.testing.assert_allclose(average, 0.5 * error)


def test_a_late_clock_corrects_the_speed_by_delay_times_acceleration(problem):
    node, delay = problem.nodes[0], 0.01
    offset = BY_NAME["time_offset"](delay=delay)
    error = compute_speed_error(node, {type(offset): offset}, is_only_source=False)
    body = node.forward.inputs.at(node.t)
    y = 0.5 * (1.0 if node.mount.side == "left" else -1.0) * node.forward.track_width
    expected = delay * (body.acceleration - y * body.yaw_acceleration)
    scale = np.abs(expected).max()
    assert scale > 0.0
    assert np.abs(error.correction - expected).max() < 0.05 * scale
