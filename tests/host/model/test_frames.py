"""Node axes: orthonormal and right-handed, and along the hub axes at wheel angle zero."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.model.frames import hub_axes, node_from_body

SIDES = ["left", "right"]


@given(
    theta=st.floats(-100, 100),
    camber=st.floats(-0.5, 0.5),
    side=st.sampled_from(SIDES),
    facing=st.sampled_from(SIDES),
)
def test_node_axes_are_right_handed_and_orthonormal(theta, camber, side, facing):
    rotation = node_from_body(np.array([theta]), side, facing, camber)[0]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("side", SIDES)
def test_at_angle_zero_x_points_up_and_y_forward(side):
    """The y axis of a node facing right is negated, as is its z axis."""
    up, forward, left = hub_axes(side, 0.1)
    np.testing.assert_allclose(node_from_body(np.zeros(1), side, "left", 0.1)[0], [up, forward, left])
    np.testing.assert_allclose(node_from_body(np.zeros(1), side, "right", 0.1)[0], [up, -forward, -left])
