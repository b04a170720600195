"""Calibrated parameters as rows of text."""

import pytest

from hubodo.calibration.file import Quantity
from hubodo.calibration.parameter_table import format_with_sigma, parameter_headings, parameter_rows


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (0.119277, 0.00028, "+0.11928 ± 0.00028"),
        (-1.42, 0.31, "-1.42 ± 0.31"),
        (6.19e-6, 3.7e-5, "(+0.6 ± 3.7)e-5"),
        (-1e-9, 0.02, "+0.000 ± 0.020"),
        (1234.5, 21.0, "+1234 ± 21"),
        (0.5, 0.0, "0.5 ± 0"),
    ],
)
def test_value_and_sigma_are_rounded_to_the_second_digit_of_sigma(value, sigma, text):
    assert format_with_sigma(value, sigma) == text


def test_a_row_has_unit_significance_and_the_meaning_once():
    effects = {"gyro_bias": {"x": Quantity(0.01, 0.001), "y": Quantity(0.0, 0.001)}}
    first, second = parameter_rows(effects)
    assert len(first) == len(parameter_headings())
    assert first[3] == "rad/s" and first[5] == "10.0 σ" and second[5] == "0.0 σ"
    assert first[6] == "the gyro reads an offset" and second[6] == ""


@pytest.mark.parametrize(
    ("effect", "parameter", "value", "sigma", "text"),
    [
        # 1 deg/h, a thousandth of standard gravity, a millionth, and a sixtieth of a degree.
        ("gyro_bias", "x", 4.84814e-6, 4.84814e-7, "+1.00 ± 0.10 °/h"),
        ("accel_bias", "z", 0.00980665, 0.000980665, "+1.00 ± 0.10 mg"),
        ("gyro_scale_factor", "y", -1e-6, 1e-7, "-1.00 ± 0.10 ppm"),
        ("gyro_nonorthogonality", "xz", 2.908882e-4, 2.95e-5, "+1.00 ± 0.10 arc-min"),
        ("gyro_lag", "time_constant", 0.01, 0.001, ""),
    ],
)
def test_values_are_also_in_the_units_of_data_sheets(effect, parameter, value, sigma, text):
    (row,) = parameter_rows({effect: {parameter: Quantity(value, sigma)}})
    assert row[4] == text
