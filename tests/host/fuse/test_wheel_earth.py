"""Earth rotation in the wheel filter: gyros sense it, the heading over ground must not contain it."""

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.errors import ConfigError
from hubodo.fuse.latitude import add_latitude
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle, parse_vehicle
from repetitions import first_and_more
from wheel_runs import tables

LATITUDE_DEG = 60.0
MOUNTS = {"left": NodeMount("left", "left"), "right": NodeMount("right", "left")}


@pytest.mark.parametrize("names", first_and_more((("left",),), (("left", "right"),)))
def test_a_latitude_removes_the_earth_rate_from_the_heading(names):
    """At latitude 60° the Earth turns by 0.217° per minute; perfect sensors, slow curves of 160 s."""
    rng = np.random.default_rng(3)
    plan = wheel_drives.legs([(10.0, 0.0, 0.0), (80.0, 1.0, 0.03), (80.0, 1.0, -0.03), (10.0, 0.0, 0.0)])
    drive = wheel_drives.drive(plan, rng, wheel_drives.PERFECT, latitude_deg=LATITUDE_DEG)
    error_deg = {}
    for latitude_deg in (None, LATITUDE_DEG):
        vehicle = Vehicle(drive.radius, drive.track, MOUNTS, latitude_deg=latitude_deg)
        track = run_wheel_filter(wheel_config(vehicle, list(names)), tables(drive)).track
        error_deg[latitude_deg] = np.degrees(
            track.heading[-1] - np.interp(track.t[-1], drive.t, drive.heading)
        )
    seconds = 160.0  # of motion; at standstill the heading is fixed
    print(error_deg)
    earth_turn_deg = np.degrees(2.0 * np.pi / 86164.0905) * np.sin(np.radians(LATITUDE_DEG)) * seconds
    assert error_deg[None] - error_deg[LATITUDE_DEG] == pytest.approx(earth_turn_deg, rel=0.1)
    assert abs(error_deg[LATITUDE_DEG]) < 0.5 * abs(error_deg[None])


def test_the_latitude_comes_from_the_vehicle_file_or_else_from_fixes():
    t = np.arange(5.0)
    fixes = Table({"t": t, "latitude_deg": np.full(5, 47.0), "longitude_deg": np.full(5, 8.0)})
    log = Recording(nodes={}, gnss=fixes)
    assert add_latitude(Vehicle(0.1, 0.5), log).latitude_deg == 47.0
    assert add_latitude(Vehicle(0.1, 0.5, latitude_deg=10.0), log).latitude_deg == 10.0
    assert add_latitude(Vehicle(0.1, 0.5), Recording(nodes={})).latitude_deg is None


def test_a_latitude_beyond_the_poles_is_refused():
    sizes = {"wheel_radius": 0.1, "track_width": 0.5}
    assert parse_vehicle({"vehicle": {**sizes, "latitude_deg": -33.9}}, "v.toml").latitude_deg == -33.9
    for invalid in (91.0, "north", True):
        with pytest.raises(ConfigError, match="latitude_deg"):
            parse_vehicle({"vehicle": {**sizes, "latitude_deg": invalid}}, "v.toml")
