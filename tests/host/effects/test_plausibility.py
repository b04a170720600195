"""Plausible magnitudes of fitted parameters."""

import pytest

from hubodo.effects.gyro import GyroSaturation
from hubodo.effects.mounting import LeverArm
from hubodo.effects.plausibility import implausible_parameters, limit_to_plausible
from hubodo.effects.vehicle import RoadGrade
from hubodo.effects.wheel import TyreGrowth

PLAUSIBLE_ARM = LeverArm.max_plausible("x")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_parameter_beyond_its_plausible_magnitude_is_limited_to_it_with_its_sign(sign):
    effect = LeverArm(x=3.0 * sign * PLAUSIBLE_ARM, y=0.01)
    assert implausible_parameters(effect) == {"x": PLAUSIBLE_ARM}
    assert limit_to_plausible(effect) == LeverArm(x=sign * PLAUSIBLE_ARM, y=0.01)


def test_a_parameter_just_below_its_limit_counts_as_at_the_limit_but_stays():
    effect = LeverArm(x=0.985 * PLAUSIBLE_ARM)
    assert implausible_parameters(effect) == {"x": PLAUSIBLE_ARM}
    assert limit_to_plausible(effect) == effect
    assert implausible_parameters(LeverArm(x=0.975 * PLAUSIBLE_ARM)) == {}


def test_a_plausible_effect_is_returned_as_it_is():
    effect = LeverArm(x=0.02)
    assert limit_to_plausible(effect) is effect


def test_a_parameter_without_a_stated_limit_is_plausible_up_to_20_scales():
    assert TyreGrowth.max_plausible("k") == pytest.approx(20.0 * TyreGrowth.scale("k"))


def test_a_positive_parameter_without_a_stated_limit_is_plausible_at_any_magnitude():
    assert implausible_parameters(GyroSaturation(limit=1e6)) == {}


def test_a_road_that_climbs_by_more_than_a_mountain_pass_throughout_is_not_plausible():
    assert implausible_parameters(RoadGrade(-0.107)) == {"angle": 0.1}
    assert implausible_parameters(RoadGrade(0.08)) == {}
