"""The latitude of a drive: that of the fixes where the vehicle file has none; mistakes in the file."""

import numpy as np
import pytest

from hubodo.fuse.latitude import add_latitude, latitude_warnings
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle

T = np.arange(5.0)
FIXES = Recording(
    {}, gnss=Table({"t": T, "latitude_deg": 0.0 * T + 47.0, "longitude_deg": 0.0 * T + 8.5, "altitude": T})
)


def vehicle(latitude_deg):
    return Vehicle(0.1, 0.5, latitude_deg=latitude_deg)


def test_the_latitude_of_fixes_is_used_where_the_vehicle_file_has_none():
    assert add_latitude(vehicle(None), FIXES).latitude_deg == 47.0
    assert add_latitude(vehicle(10.0), FIXES).latitude_deg == 10.0
    assert add_latitude(vehicle(None), Recording({})).latitude_deg is None


@pytest.mark.parametrize(
    ("latitude_deg", "mistake"),
    [(8.4, "longitude"), (-47.1, "sign"), (0.82, "radians"), (30.0, "are at 47.00 degrees; correct")],
)
def test_a_latitude_that_is_not_that_of_the_fixes_is_named(latitude_deg, mistake):
    (warning,) = latitude_warnings(vehicle(latitude_deg), FIXES)
    assert mistake in warning


@pytest.mark.parametrize("latitude_deg", [None, 47.5])
def test_a_latitude_near_the_fixes_has_no_warning(latitude_deg):
    assert latitude_warnings(vehicle(latitude_deg), FIXES) == ()
