"""Saturated channels are refused at standstill and remarked in motion; coarse ones are not saturated."""

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.filters.compare import compare_filters
from hubodo.sensors.heading.estimate import HeadingOptions, heading_from_recording
from hubodo.sensors.saturation import saturated_value
from hubodo.sensors.standstill_channel import read_standstill_channel

DEG = np.pi / 180.0


def recording_of(rate):
    rng = np.random.default_rng(3)
    n = len(rate)
    columns = {name: 0.001 * rng.standard_normal(n) for name in ("gx", "gy", "ax", "ay")}
    columns |= {"t": np.arange(n) / 50.0, "gz": rate, "az": 9.81 + 0.01 * rng.standard_normal(n)}
    return Recording({"imu": Table(columns)})


def noise(seed=1, count=6000, sigma=0.2 * DEG):
    return 0.3 * DEG + sigma * np.random.default_rng(seed).standard_normal(count)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pile_of_samples_at_an_end_is_saturation(sign):
    value, share = saturated_value(sign * np.minimum(noise(), 0.5 * DEG))
    assert value == pytest.approx(sign * 0.5 * DEG)
    assert share == pytest.approx(0.1587, abs=0.02)  # beyond one sigma of a normal distribution


@pytest.mark.parametrize("lsb", [0.02, 0.05, 0.1, 0.3, 1.0])
def test_no_resolution_is_saturation_by_itself(lsb):
    """Normal noise of 0.2 deg/s with steps of a tenth to five sigma, seeds 0 to 49."""
    assert all(saturated_value(np.round(noise(seed) / (lsb * DEG)) * lsb * DEG) is None for seed in range(50))


def test_each_command_reports_a_saturated_gyro():
    recording = recording_of(np.minimum(noise(), 0.3 * DEG))
    with pytest.raises(InputError, match=r"49% of the samples of gz equal 0\.00523599.*larger range"):
        read_standstill_channel(recording, "imu", "gz", log="night")
    with pytest.raises(InputError, match=r"gz at standstill .*saturated"):
        heading_from_recording(recording, "imu", HeadingOptions(standstills=[(0.0, 100.0)]), log="night")
    result = compare_filters(recording, "imu", "gz")
    assert any("saturated gyro" in note for note in result.notes)


def test_a_heading_with_clipped_turns_says_that_rotation_is_missing():
    rate = noise()
    rate[3000:4000] += 300.0 * DEG
    options = HeadingOptions(standstills=[(0.0, 55.0)])
    clear = heading_from_recording(recording_of(rate), "imu", options, log="drive")
    clipped = heading_from_recording(recording_of(np.minimum(rate, 250.0 * DEG)), "imu", options, log="drive")
    assert not any("range" in note for note in clear.notes)
    assert any("rotation beyond it is missing" in note for note in clipped.notes)


def test_filters_of_a_stuck_gyro_are_refused():
    with pytest.raises(InputError, match="stuck or not connected"):
        compare_filters(recording_of(np.full(6000, 0.01)), "imu", "gz")
