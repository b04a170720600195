"""Lengths as people write them."""

import pytest

from hubodo.errors import InputError
from hubodo.lengths import format_length, parse_length


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("33 cm", 0.33),
        ("33cm", 0.33),
        ("330 mm", 0.33),
        ("0,33 m", 0.33),
        ("13 in", 0.3302),
        ('13"', 0.3302),
        ("2 ft", 0.6096),
        ("1 ft 10 in", 0.5588),
        ("1' 10.5\"", 0.5715),
        (" 2M ", 2.0),
    ],
)
def test_a_length_is_read_with_its_unit(text, metres):
    assert parse_length(text, "track") == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize("text", ["33", "", "cm", "-3 cm", "3 parsec", "0 cm", "1e3 m", "nan m"])
def test_a_length_without_a_unit_is_refused(text):
    with pytest.raises(InputError, match="track"):
        parse_length(text, "track")


def test_a_length_is_shown_in_a_common_unit():
    assert (format_length(0.165), format_length(1.42)) == ("16.5 cm", "1.42 m")
