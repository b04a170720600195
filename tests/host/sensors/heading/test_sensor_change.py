"""A record joined from two sensors is refused; vibration, turns and marked standstills are not."""

import numpy as np
import pytest

from generators.odd_records import CHANGES
from generators.steady_turns import steady_turns
from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.heading.estimate import HeadingOptions, heading_from_recording
from hubodo.sensors.heading.sensor_change import check_one_sensor

NAMES = ("t", "gx", "gy", "gz", "ax", "ay", "az")


def two_sensors(seed):
    t, gyro, accel, _ = steady_turns([seed, 4], scale_sigma=0.01, standstills=(0, 9))
    rng = np.random.default_rng([seed, 5])
    t, gyro, accel = CHANGES["half of another unit"](t, gyro, accel, rng, np.radians(0.02))
    return Recording({"imu": Table(dict(zip(NAMES, (t, *gyro.T, *accel.T), strict=True)))})


def test_a_record_of_two_sensors_is_refused_with_its_time():
    """Seed 915 was answered with an error of 13 sigma: its second bias was taken for a slow turn."""
    with pytest.raises(InputError, match=r"noise of the gyro changes by a factor of 3\.?\d? at about 15\d s"):
        heading_from_recording(two_sensors(915), "imu", HeadingOptions(), log="log")
    marked = HeadingOptions(standstills=((0.5, 29.0), (271.0, 299.0)))
    assert heading_from_recording(two_sensors(915), "imu", marked, log="log").track is not None


@pytest.mark.parametrize("kind", ["vibration in motion", "rough road"])
def test_noise_that_follows_the_motion_is_no_other_sensor(kind):
    rng = np.random.default_rng(3)
    t = np.arange(24_000) / 50.0
    level = np.ones(len(t))
    spans = ((0, 3000),)
    if kind == "vibration in motion":
        level[3000:] = 4.0
    else:
        level[3000:] = np.repeat(np.exp(rng.normal(0.8, 0.4, 21)), 1000)
    check_one_sensor(t, 1e-3 * level * rng.standard_normal(len(t)), spans)
    level[12_000:] *= 3.0
    if kind == "vibration in motion":
        with pytest.raises(InputError, match="as between two sensors"):
            check_one_sensor(t, 1e-3 * level * rng.standard_normal(len(t)), spans)
