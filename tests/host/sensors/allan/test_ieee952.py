"""Units of noise terms: conversions of typical data sheet values by hand."""

import math

import pytest

from hubodo.sensors.allan.ieee952 import is_gyro, rate_unit, term_units


def test_gyro_terms_convert_to_degrees_and_hours():
    units = term_units("gz")
    assert units["N"].common == "deg/√h" and math.radians(1.0) / 60.0 * units["N"].factor == pytest.approx(
        1.0
    )
    assert math.radians(1.0) / 3600.0 * units["B"].factor == pytest.approx(1.0)
    assert math.radians(1.0) / 3600.0 / 60.0 * units["K"].factor == pytest.approx(1.0)


def test_accelerometer_terms_convert_to_micro_g_and_hours():
    units = term_units("ax")
    assert 9.80665e-6 * units["B"].factor == pytest.approx(1.0)
    assert units["N"].factor == pytest.approx(60.0)


def test_the_first_letter_of_a_channel_selects_the_sensor():
    assert [is_gyro(name) for name in ("gx", "ay")] == [True, False]
    assert (rate_unit("gx").si, rate_unit("az").si) == ("rad/s", "m/s²")
