"""Frames of a vehicle's sensors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hubodo.log.frames import GNSS_FRAME, sensor_frames
from hubodo.vehicle import NodeMount, Vehicle


@pytest.mark.parametrize(("facing", "z_axis"), [("left", [0, 1, 0]), ("right", [0, -1, 0])])
@pytest.mark.parametrize(("side", "y"), [("left", 0.3), ("right", -0.3)])
def test_the_z_axis_of_a_wheel_node_points_where_it_faces_and_x_up(facing, z_axis, side, y):
    vehicle = Vehicle(0.2, 0.6, {"n": NodeMount(side, facing)}, antenna=(0.5, 0.1))
    node, antenna = sensor_frames(vehicle)
    rotation = Rotation.from_quat(node.rotation)
    assert rotation.apply([0, 0, 1]) == pytest.approx(np.array(z_axis), abs=1e-12)
    assert rotation.apply([1, 0, 0]) == pytest.approx([0, 0, 1], abs=1e-12)
    assert node.position == (0.0, y, 0.2)
    assert (antenna.name, antenna.position) == (GNSS_FRAME, (0.5, 0.1, 0.0))
