"""The warning about a random walk that hardly any gyro has: degrees per second read as rad/s."""

import math

import numpy as np
import pytest

from hubodo.recording import Recording, Table
from hubodo.sensors.allan.characterise import characterise_standstill_noise
from hubodo.sensors.standstill_channel import read_standstill_channel


def notes_of(sigma, channel="gz", rate=50.0):
    """Return the warnings about white noise of `sigma` per sample with stated units."""
    rng = np.random.default_rng(17)
    n = 6000
    columns = {name: sigma * rng.standard_normal(n) for name in ("gx", "gy", "gz", "ax", "ay", "az")}
    table = Table({"t": np.arange(n) / rate} | columns)
    record = read_standstill_channel(Recording({"imu": table}), "imu", channel, log="night", trust_units=True)
    return characterise_standstill_noise(record).notes


def test_white_noise_in_degrees_per_second_read_as_rad_per_second_is_remarked_upon():
    """0.05 deg/s per sample at 50 Hz is N = 0.05 / sqrt(50) = 7.1e-3, as rad/s 24 deg/sqrt(h)."""
    (note,) = [text for text in notes_of(0.05) if "--unit" in text]
    value = float(note.split("walk of ")[1].split(" deg")[0])
    assert value == pytest.approx(math.degrees(0.05 / math.sqrt(50.0)) * 60.0, rel=0.05)
    assert "57 times too large" in note


@pytest.mark.parametrize(("walk_deg_sqrt_h", "is_remarked"), [(5.0, False), (8.5, False), (12.0, True)])
def test_the_remark_begins_at_ten_degrees_per_root_hour(walk_deg_sqrt_h, is_remarked):
    sigma = math.radians(walk_deg_sqrt_h / 60.0) * math.sqrt(50.0)
    assert any("--unit" in text for text in notes_of(sigma)) == is_remarked


def test_an_accelerometer_has_no_such_remark():
    assert not any("--unit" in text for text in notes_of(0.5, "ax"))
