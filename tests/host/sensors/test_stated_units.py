"""Stated units are not checked; motion and wrong time units are not mistaken for another unit of the rate."""

import numpy as np
import pytest

from generators import start_gyro
from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.standstill_channel import read_standstill_channel
from hubodo.sensors.standstill_checks import check_units


def test_the_noise_of_an_old_gyro_is_accepted_in_a_unit_that_was_stated():
    t, output = start_gyro.overnight(60.0, 12 * 3600.0, np.random.default_rng(1))
    missing = np.full(len(t), np.nan)
    columns = dict.fromkeys(("gx", "gy", "ax", "ay", "az"), missing)
    recording = Recording({"start": Table({"t": t, "gz": np.radians(output), **columns})})
    with pytest.raises(InputError, match="--unit"):
        read_standstill_channel(recording, "start", "gz", log="start.csv")
    record = read_standstill_channel(
        recording, "start", "gz", log="start.csv", stated_units=frozenset({"gyro"})
    )
    assert len(record.values) == len(t)


@pytest.mark.parametrize("unit, factor", [("ms", 1e3), ("us", 1e6)])
def test_times_in_another_unit_are_named(unit, factor):
    gyro = np.random.default_rng(2).normal(0.01, 0.003, (4000, 3))
    check_units(gyro, None, 0.01)
    with pytest.raises(InputError, match=f"times look like {unit}; name their column t_{unit}"):
        check_units(gyro, None, 0.01 * factor)


def test_a_drive_is_named_as_not_at_rest():
    t = np.arange(6000) / 100
    rate = 6.0 + 2.0 * np.sin(0.3 * t) + np.random.default_rng(3).normal(0.0, 0.05, len(t))
    with pytest.raises(InputError, match="this record is not at rest"):
        check_units(np.column_stack([0.01 * rate, 0.02 * rate, rate]), None, 0.01)


def test_a_stationary_gyro_in_degrees_per_second_still_is_named_by_its_unit():
    gyro = np.random.default_rng(4).normal(1.0, 0.2, (6000, 3))
    with pytest.raises(InputError, match="looks like deg/s"):
        check_units(gyro, None, 0.01)
