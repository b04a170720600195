"""Effects of a wheel on the geometry, by hand."""

import numpy as np
import pytest

from hubodo.effects import Geometry
from hubodo.effects.wheel import TyreGrowth, WheelCamber, WheelEccentricity, WheelRadius, WheelSlip

WHEEL = Geometry("left", 0.3, 0.9)


def test_each_effect_changes_its_own_quantity():
    geometry = WHEEL
    for effect in (WheelRadius(0.01), TyreGrowth(2e-5), WheelSlip(0.02), WheelCamber(0.1)):
        geometry = effect.adjust_geometry(geometry)
    values = (geometry.radius, geometry.tyre_growth, geometry.wheel_slip, geometry.camber)
    assert values == pytest.approx((0.303, 2e-5, 0.02, 0.1))


def test_eccentricities_add_as_vectors():
    geometry = WheelEccentricity(0.03, 0.0).adjust_geometry(WHEEL)
    geometry = WheelEccentricity(0.04, np.pi / 2.0).adjust_geometry(geometry)
    np.testing.assert_allclose(geometry.eccentricity, (0.03, 0.04))
    assert WheelEccentricity().with_coordinates(np.array([0.03, 0.04])).amplitude == pytest.approx(0.05)
