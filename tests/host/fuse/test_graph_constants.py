"""Prior sigmas of the constants from the wheel filter, bounded below by hourly changes of tyre and road."""

import numpy as np
import pytest

from hubodo.fuse.graph.factors.constants import ConstantSigmas, sigmas_for_wheel_filter
from hubodo.fuse.wheel.config import RadiusSigmas, WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import WHEEL_RADIUS
from hubodo.fuse.wheel.filter_core import FilterCore


def test_the_errors_of_two_wheels_average_except_their_common_yaw_scale():
    nodes = {side: WheelNode(side, "left") for side in ("left", "right")}
    sigmas = RadiusSigmas(common=0.009, own=0.004)
    one = FilterCore(WheelConfig(0.3, 1.4, {"left": nodes["left"]}, radius_sigmas=sigmas))
    two = FilterCore(WheelConfig(0.3, 1.4, nodes, radius_sigmas=sigmas))
    assert one.mean_sigma(WHEEL_RADIUS) == pytest.approx(0.004)
    assert two.mean_sigma(WHEEL_RADIUS) == pytest.approx(0.004 / np.sqrt(2.0))
    assert two.common_scale_sigma == 0.009
    assert sigmas_for_wheel_filter(0.004, [0.0042, 0.0041], 1.2e-4).yaw_scale == 0.0041


def test_even_after_a_perfect_calibration_sigmas_cover_changes_from_hour_to_hour():
    result = sigmas_for_wheel_filter(1e-6, [1e-6], 1e-9)
    assert min(result.wheel_radius, result.yaw_scale) >= 5e-4
    assert result.yaw_rate >= 5e-5
    assert result.curvature > 0.0


def test_sigmas_from_the_wheel_filter_never_exceed_the_defaults():
    informed, unknown = sigmas_for_wheel_filter(0.004, [0.0075], 1.2e-4), ConstantSigmas()
    assert np.all(informed.to_array() <= unknown.to_array())
