"""Units of gyro and accelerometer."""

import math

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.log.units import explain_suspect_units, si_factor


@pytest.mark.parametrize(
    ("text", "sensor", "factor"),
    [
        ("deg/s", "gyro", math.pi / 180),
        ("dps", "gyro", math.pi / 180),
        ("0.00875 deg/s", "gyro", 0.00875 * math.pi / 180),
        ("deg/h", "gyro", math.pi / 180 / 3600),
        ("mg", "accel", 9.80665e-3),
        ("m/s²", "accel", 1.0),
    ],
)
def test_a_unit_or_the_value_of_one_count_has_a_factor_to_si(text, sensor, factor):
    assert si_factor(text) == (sensor, pytest.approx(factor, rel=1e-14))


@pytest.mark.parametrize("text", ["", "rpm", "0 deg/s", "nan g", "x deg/s"])
def test_another_unit_is_refused_with_the_known_ones(text):
    with pytest.raises(InputError, match="give one of rad/s"):
        si_factor(text)


def test_data_in_g_or_degrees_per_second_are_suspect_and_si_data_are_not():
    rng = np.random.default_rng(1)
    gyro, accel = rng.normal(0, 5, (1000, 3)), rng.normal([0, 0, 9.81], 1, (1000, 3))
    accel[3] = np.nan
    assert explain_suspect_units(gyro, accel) is None
    assert "probably in g" in explain_suspect_units(gyro, accel / 9.81)
    assert "degrees per second" in explain_suspect_units(gyro * 180 / np.pi, accel)
