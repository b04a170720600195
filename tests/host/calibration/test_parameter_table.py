"""Calibrated parameters as rows of text."""

import pytest

from hubodo.calibration.file import Quantity
from hubodo.calibration.parameter_table import PARAMETER_HEADINGS, format_with_sigma, parameter_rows


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (0.119277, 0.00028, "+0.11928 ± 0.00028"),
        (-1.42, 0.31, "-1.42 ± 0.31"),
        (6.19e-6, 3.7e-5, "(+0.6 ± 3.7)e-5"),
        (1234.5, 21.0, "+1234 ± 21"),
        (0.5, 0.0, "0.5 ± 0"),
    ],
)
def test_value_and_sigma_are_rounded_to_the_second_digit_of_sigma(value, sigma, text):
    assert format_with_sigma(value, sigma) == text


def test_a_row_has_unit_significance_and_the_meaning_once():
    effects = {"gyro_bias": {"x": Quantity(0.01, 0.001), "y": Quantity(0.0, 0.001)}}
    first, second = parameter_rows(effects)
    assert len(first) == len(PARAMETER_HEADINGS)
    assert first[3:5] == ("rad/s", "10.0 σ") and second[4] == "0.0 σ"
    assert first[5] == "the gyro reads an offset" and second[5] == ""
