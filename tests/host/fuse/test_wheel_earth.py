"""The ground turns with the Earth: a gyro feels it, a heading over ground does not change by it."""

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.errors import ConfigError
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.fuse.wheel_odometry import add_latitude
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle, parse_vehicle
from wheel_runs import tables

LATITUDE_DEG = 60.0
MOUNTS = {"left": NodeMount("left", "left"), "right": NodeMount("right", "left")}


@pytest.mark.parametrize("names", [("left",), ("left", "right")])
def test_with_a_latitude_the_heading_stays_that_over_ground(names):
    """At 60 degrees 0.217 degrees a minute: three minutes of slow curves with a perfect sensor."""
    rng = np.random.default_rng(3)
    plan = wheel_drives.legs([(10.0, 0.0, 0.0), (80.0, 1.0, 0.03), (80.0, 1.0, -0.03), (10.0, 0.0, 0.0)])
    drive = wheel_drives.drive(plan, rng, wheel_drives.PERFECT, latitude_deg=LATITUDE_DEG)
    off = {}
    for latitude_deg in (None, LATITUDE_DEG):
        vehicle = Vehicle(drive.radius, drive.track, MOUNTS, latitude_deg=latitude_deg)
        track = run_wheel_filter(wheel_config(vehicle, list(names)), tables(drive)).track
        off[latitude_deg] = np.degrees(track.heading[-1] - np.interp(track.t[-1], drive.t, drive.heading))
    seconds = 160.0  # it moves
    print(off)
    turned = np.degrees(2.0 * np.pi / 86164.0905) * np.sin(np.radians(LATITUDE_DEG)) * seconds
    assert off[None] - off[LATITUDE_DEG] == pytest.approx(turned, rel=0.1)
    assert abs(off[LATITUDE_DEG]) < 0.5 * abs(off[None])


def test_the_latitude_is_the_files_else_that_of_the_fixes():
    t = np.arange(5.0)
    fixes = Table({"t": t, "latitude_deg": np.full(5, 47.0), "longitude_deg": np.full(5, 8.0)})
    log = Recording(nodes={}, gnss=fixes)
    assert add_latitude(Vehicle(0.1, 0.5), log).latitude_deg == 47.0
    assert add_latitude(Vehicle(0.1, 0.5, latitude_deg=10.0), log).latitude_deg == 10.0
    assert add_latitude(Vehicle(0.1, 0.5), Recording(nodes={})).latitude_deg is None


def test_a_latitude_beyond_the_poles_is_refused():
    sizes = {"wheel_radius": 0.1, "track_width": 0.5}
    assert parse_vehicle({"vehicle": {**sizes, "latitude_deg": -33.9}}, "v.toml").latitude_deg == -33.9
    for wrong in (91.0, "north", True):
        with pytest.raises(ConfigError, match="latitude_deg"):
            parse_vehicle({"vehicle": {**sizes, "latitude_deg": wrong}}, "v.toml")
