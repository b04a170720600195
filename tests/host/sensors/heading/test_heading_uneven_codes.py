"""Uneven codes of the gyro's converter in standstills: named, and part of the heading's sigma."""

import numpy as np

from generators.odd_records import disturb
from generators.steady_turns import steady_turns
from hubodo.recording import Recording, Table
from hubodo.sensors.heading.estimate import HeadingOptions, heading_from_recording


def judge(change):
    """Return the heading error in degrees, its sigma, and the remark on codes, of one record."""
    t, gyro, accel, true = steady_turns([900, 4], standstills=(0, 9))
    t, gyro, accel = disturb(change, t, gyro, accel, np.random.default_rng([900, 5]), 0.0)
    columns = dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True))
    options = HeadingOptions(standstills=[(1.0, 29.0), (271.0, 299.0)], scale_sigma=1e-4)
    result = heading_from_recording(Recording({"imu": Table(columns)}), "imu", options, log="log")
    error = result.track.heading[-1] - true[-1]
    notes = [note for note in result.notes if "the codes of the gyro's converter are uneven by" in note]
    return np.degrees(error), np.degrees(result.track.sigma[-1]), notes


def test_the_error_of_uneven_codes_is_part_of_sigma():
    _, even_sigma, notes = judge("none")
    assert not notes
    error, sigma, notes = judge("missing codes")
    assert len(notes) == 1 and sigma > 1.5 * even_sigma
    assert 3 * even_sigma < abs(error) < 3 * sigma
