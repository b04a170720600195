"""Speed and steps of a track with GNSS: those of the wheels, without the corrections by fixes."""

import numpy as np
import pytest

import wheel_runs
from generators import gnss_drives, wheel_drives
from hubodo.fuse.fusion import fuse_outside_sensors
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle

SIGMA = 0.5


@pytest.fixture(scope="module")
def parked_twice():
    """Return a drive of half a minute between two standstills, and its track with fixes of 0.5 m at 5 Hz."""
    rng = np.random.default_rng(81)
    legs = [(8.0, 0.0, 0.0), (8.0, 1.5, 0.2), (8.0, 1.0, -0.3), (8.0, 1.7, 0.1), (10.0, 0.0, 0.0)]
    drive = wheel_drives.drive(wheel_drives.legs(legs), rng)
    t = np.arange(0.07, drive.t[-1], 0.2)
    east, north = (
        np.interp(t, drive.t, value) + SIGMA * rng.standard_normal(len(t)) for value in (drive.x, drive.y)
    )
    latitude, longitude = gnss_drives.geodetic(east, north, 47.37, 8.54)
    columns = {"t": t, "latitude_deg": latitude, "longitude_deg": longitude, "altitude": 0.0 * t}
    gnss = Table({**columns, "sigma": np.full(len(t), SIGMA)})
    mounts = {side: NodeMount(side, "left") for side in ("left", "right")}
    recording = Recording(wheel_runs.tables(drive), gnss=gnss)
    odometry = compute_wheel_odometry(
        recording, Vehicle(drive.radius, drive.track, mounts), log="drive", for_graph=True
    )
    return drive, fuse_outside_sensors(recording, odometry).track


def test_the_speed_is_that_of_the_vehicle_and_zero_while_it_is_parked(parked_twice):
    """A pose's speed is the mean over the tenth of a second before it."""
    drive, track = parked_twice
    truth = np.interp(track.t - 0.05, drive.t, drive.speed)
    parked = np.interp(track.t, drive.t, drive.speed) + np.interp(track.t - 0.1, drive.t, drive.speed) < 1e-9
    assert np.count_nonzero(parked) > 100
    assert np.max(np.abs(track.speed[parked])) < 1e-3
    # The scale of the wheels, half a percent, is the largest part.
    assert np.sqrt(np.mean((track.speed - truth)[5:] ** 2)) < 0.02


def test_positions_step_by_what_the_wheels_rolled(parked_twice):
    drive, track = parked_twice
    step = np.hypot(np.diff(track.x), np.diff(track.y))
    true_step = np.hypot(*(np.diff(np.interp(track.t, drive.t, value)) for value in (drive.x, drive.y)))
    assert np.max(np.abs(step - true_step)) < 0.01
    assert np.max(np.abs(step - true_step)) < 0.1 * np.min(np.hypot(track.sigma_x, track.sigma_y))
