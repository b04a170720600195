"""Misalignment and lever arm of a node, by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_chains import two_samples

from hubodo.effects import Geometry
from hubodo.effects.mounting import LeverArm, NodeMisalignment


def test_a_node_rotated_by_a_right_angle_measures_x_as_minus_y_and_back():
    chain = two_samples(gyro=(1.0, 0.0, 0.0), accel=(0.0, 2.0, 0.0))
    effect = NodeMisalignment(z=np.pi / 2.0)
    effect.rotate_into_node(chain)
    np.testing.assert_allclose(chain.rate[:, 0], [0.0, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(chain.force[:, 0], [2.0, 0.0, 0.0], atol=1e-12)
    effect.rotate_out_of_node(chain)
    np.testing.assert_allclose(chain.rate[:, 0], [1.0, 0.0, 0.0], atol=1e-12)


def test_lever_arms_add_up():
    geometry = LeverArm(x=0.1).adjust_geometry(
        LeverArm(x=0.02, z=-0.01).adjust_geometry(Geometry(None, 0.3, 0.9))
    )
    np.testing.assert_allclose(geometry.lever_arm, (0.12, 0.0, -0.01))
    assert "0.5 m off" in LeverArm(x=0.3, y=0.4).describe()


def test_a_rotation_about_the_axle_adds_to_that_of_a_tilted_node():
    tilt = Rotation.from_rotvec([0.3, -0.2, 0.1])
    turned = NodeMisalignment(*(Rotation.from_rotvec([0.0, 0.0, 0.5]) * tilt).as_rotvec())
    assert turned.axle_rotation() - NodeMisalignment(*tilt.as_rotvec()).axle_rotation() == pytest.approx(0.5)
    assert NodeMisalignment(z=-0.4).axle_rotation() == pytest.approx(-0.4)
    assert NodeMisalignment().axle_rotation() == 0.0
