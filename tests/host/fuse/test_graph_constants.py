"""What the graph expects of the wheel filter's track: its own sigmas, and never less than a tyre changes."""

import numpy as np
import pytest

from hubodo.fuse.graph.factors.constants import ConstantSigmas, sigmas_for_wheel_filter


def test_the_errors_of_two_wheels_average_but_for_the_scale_that_they_agree_on():
    one = sigmas_for_wheel_filter([0.004], [0.0075], [1.2e-4])
    two = sigmas_for_wheel_filter([0.004, 0.004], [0.0041, 0.0042], [1.2e-4, 1.2e-4])
    assert (one.wheel_radius, one.yaw_scale, one.yaw_rate) == (0.004, 0.0075, 1.2e-4)
    assert two.wheel_radius == pytest.approx(0.004 / np.sqrt(2.0))
    assert two.yaw_rate == pytest.approx(1.2e-4 / np.sqrt(2.0))
    assert two.yaw_scale == 0.0041


def test_a_calibration_however_good_leaves_what_changes_from_hour_to_hour():
    found = sigmas_for_wheel_filter([1e-6], [1e-6], [1e-9])
    assert min(found.wheel_radius, found.yaw_scale) >= 5e-4
    assert found.yaw_rate >= 5e-5
    assert found.curvature > 0.0


def test_it_is_never_looser_than_what_the_graph_takes_of_an_unknown_odometry():
    informed, unknown = sigmas_for_wheel_filter([0.004], [0.0075], [1.2e-4]), ConstantSigmas()
    assert np.all(informed.to_array() <= unknown.to_array())
