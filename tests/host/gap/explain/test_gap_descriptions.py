"""Descriptions of residuals, and of manoeuvres that separate similar effects."""

import numpy as np

from gap_residuals import build_residual, draw_readings
from hubodo.gap.explain.descriptions import describe_manoeuvre, describe_where


def test_a_manoeuvre_is_given_for_each_inseparable_effect():
    text = describe_manoeuvre("accel_scale_factor", ["accel_nonorthogonality", "gyro_bias"])
    assert "from accel_nonorthogonality, accelerate and turn hard, both ways" in text
    assert "from gyro_bias, vary speed" in text


def test_the_same_manoeuvre_is_given_once_and_unnamed_terms_are_one():
    tones = [f"empirical:gx,gy ~ cos(2*pi*22.5886{k}*t)" for k in (1, 2)]
    text = describe_manoeuvre("accel_nonorthogonality", [tones[0], "gyro_lag", tones[1]])
    assert text.count("vary speed") == 1 and "from gyro_lag or an unnamed term, vary speed" in text


def test_no_channel_is_named_if_residuals_did_not_change():
    clean, y = draw_readings(np.random.default_rng(9))
    residuals = {"left": build_residual(y, clean)}
    assert describe_where(residuals, residuals) == "in no channel by itself"
