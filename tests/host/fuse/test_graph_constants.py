"""Prior sigmas of the constants from the wheel filter, bounded below by hourly changes of tyre and road."""

import numpy as np
import pytest

from hubodo.fuse.graph.factors.constants import ConstantSigmas, sigmas_for_wheel_filter


def test_the_errors_of_two_wheels_average_except_their_common_yaw_scale():
    one = sigmas_for_wheel_filter([0.004], [0.0075], [1.2e-4])
    two = sigmas_for_wheel_filter([0.004, 0.004], [0.0041, 0.0042], [1.2e-4, 1.2e-4])
    assert (one.wheel_radius, one.yaw_scale, one.yaw_rate) == (0.004, 0.0075, 1.2e-4)
    assert two.wheel_radius == pytest.approx(0.004 / np.sqrt(2.0))
    assert two.yaw_rate == pytest.approx(1.2e-4 / np.sqrt(2.0))
    assert two.yaw_scale == 0.0041


def test_even_after_a_perfect_calibration_sigmas_cover_changes_from_hour_to_hour():
    result = sigmas_for_wheel_filter([1e-6], [1e-6], [1e-9])
    assert min(result.wheel_radius, result.yaw_scale) >= 5e-4
    assert result.yaw_rate >= 5e-5
    assert result.curvature > 0.0


def test_sigmas_from_the_wheel_filter_never_exceed_the_defaults():
    informed, unknown = sigmas_for_wheel_filter([0.004], [0.0075], [1.2e-4]), ConstantSigmas()
    assert np.all(informed.to_array() <= unknown.to_array())
