"""Inputs of the forward model from a log: its reference, or its fixes."""

import numpy as np
import pytest

from generators import gnss_drives
from hubodo.errors import InputError
from hubodo.fuse.drive_from_log import estimate_drive_from_fixes, read_reference_drive
from hubodo.recording import Recording, Table

T = np.arange(0.0, 60.05, 0.2)
INNER = np.arange(5.0, 55.0, 0.5)


def test_a_reference_is_smoothed_and_starts_at_zero():
    rng = np.random.default_rng(5)
    noisy = 2.0 + np.sin(0.2 * T) + 0.05 * rng.standard_normal(len(T))
    table = Table({"t": T + 100.0, "speed": noisy, "yaw_rate": 0.1 + 0.0 * T})
    inputs = read_reference_drive(Recording({}, reference=table), "log")
    assert np.abs(inputs.speed(INNER) - 2.0 - np.sin(0.2 * INNER)).max() < 0.05
    assert inputs.yaw_rate(INNER) == pytest.approx(np.full(len(INNER), 0.1), abs=1e-6)


def test_fixes_on_a_circle_have_its_speed_and_yaw_rate():
    """The circle has a radius of 20 m and is driven at 0.1 rad/s, so at 2 m/s."""
    latitude, longitude = gnss_drives.geodetic(20.0 * np.sin(0.1 * T), -20.0 * np.cos(0.1 * T), 47.0, 8.0)
    table = Table({"t": T, "latitude_deg": latitude, "longitude_deg": longitude, "altitude": 0.0 * T})
    inputs = estimate_drive_from_fixes(Recording({}, gnss=table), "log")
    assert inputs.speed(INNER) == pytest.approx(np.full(len(INNER), 2.0), rel=0.01)
    assert inputs.yaw_rate(INNER) == pytest.approx(np.full(len(INNER), 0.1), rel=0.02)


def test_fewer_than_twenty_rows_are_refused():
    short = Table({"t": T[:19], "speed": T[:19], "yaw_rate": T[:19]})
    with pytest.raises(InputError, match="has 19 of the 20 rows of reference"):
        read_reference_drive(Recording({}, reference=short), "log")
    with pytest.raises(InputError, match="has none of the 20 rows of gnss"):
        estimate_drive_from_fixes(Recording({}), "log")
