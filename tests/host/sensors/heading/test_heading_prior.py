"""Orientation of a gyro axis from gravity."""

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.sensors.heading.prior import axis_direction


@pytest.mark.parametrize(
    "force, direction, remark",
    [
        ([0.0, 0.0, 9.8], 1.0, ""),
        ([0.0, 0.0, -9.8], -1.0, ""),
        ([9.8 * np.sin(0.1), 0.0, 9.8 * np.cos(0.1)], 1.0, "tilted by 5.7 degrees"),
        ([0.0, 0.0, 0.0], 1.0, "no gravity"),
    ],
)
def test_the_axis_points_up_or_down_and_tilt_is_reported(force, direction, remark):
    up, text = axis_direction(np.tile(force, (4, 1)), "z")
    assert up == direction and remark in text and bool(text) == bool(remark)


def test_the_axis_of_a_wheel_is_refused():
    angle = np.linspace(0.0, 20.0 * np.pi, 1000, endpoint=False)
    force = 9.8 * np.column_stack([np.sin(angle), np.cos(angle), 0.0 * angle])
    with pytest.raises(InputError, match="as on a wheel: its angle is not the heading"):
        axis_direction(force, "z")


def test_a_level_axis_is_refused():
    with pytest.raises(InputError, match="tilted by 90 degrees"):
        axis_direction(np.tile([0.0, 0.0, 9.8], (4, 1)), "x")
