"""Descriptions of residuals and of look-alikes."""

import numpy as np

from gap_residuals import shown, white
from hubodo.gap.explain.descriptions import describe_manoeuvre, describe_where


def test_each_look_alike_comes_with_a_manoeuvre():
    text = describe_manoeuvre("accel_scale_factor", ["accel_nonorthogonality", "gyro_bias"])
    assert "from accel_nonorthogonality, accelerate and turn hard, both ways" in text
    assert "from gyro_bias, vary speed" in text


def test_without_a_change_no_channel_stands_out():
    clean, y = white(np.random.default_rng(9))
    residuals = {"left": shown(y, clean)}
    assert describe_where(residuals, residuals) == "in no channel by itself"
