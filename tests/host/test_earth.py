"""The vertical component of the Earth rate."""

import pytest

from hubodo.earth import EARTH_RATE, vertical_earth_rate


def test_the_vertical_rate_is_a_turn_per_day_at_the_pole_and_none_at_the_equator():
    assert pytest.approx(6.283185307, rel=1e-8) == EARTH_RATE * 86164.0905
    assert vertical_earth_rate(90.0) == pytest.approx(EARTH_RATE)
    assert vertical_earth_rate(0.0) == 0.0
    assert vertical_earth_rate(-30.0) == pytest.approx(-0.5 * EARTH_RATE)
